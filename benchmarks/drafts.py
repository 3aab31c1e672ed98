"""How many drafts are right of folders of logs in the styles of 48 laboratories and machines.

Four sets of twelve: each was written with its truths before any of its folders was drafted, and
drafts were improved with it afterwards. `python benchmarks/drafts.py` prints how many are right;
notes/2026-11-25-folders-of-logs.md has the counts.
"""

import datetime
import tempfile
import tomllib
from pathlib import Path

import numpy as np
import polars as pl
import scipy.io
from simulated.laboratories import (
    Truth,
    arm,
    cart_and_pole,
    differences,
    follow,
    joints,
    levels,
    moves,
    simulate,
    sines,
    slide,
    wheel,
)

import tustinnet as tn
from tustinnet.cli.init import make_draft
from tustinnet.data.drafting.files import list_logs


def generator(number: int) -> np.random.Generator:
    """The random numbers of a folder."""
    return np.random.default_rng(1000 + number)


def text(path, header, columns, sep=",", fmt="%.6g", decimal=".", encoding="utf-8"):
    """Writes columns below a header."""
    rows = [
        sep.join(fmt % x for x in row).replace(".", decimal) for row in np.column_stack(columns)
    ]
    Path(path).write_bytes((header + "\n".join(rows) + "\n").encode(encoding))


def epos(f):
    r, dt, n = generator(301), 0.001, 3000
    u = levels(r, 4, n, 2.5, 220)
    q, v = simulate(wheel, u, dt, np.zeros((4, 1)))
    for k in range(4):
        head = "EPOS Studio Data Recorder\nDevice;EPOS4 50/5\nSampling period [ms];1\n\n"
        head += (
            "Time [ms];Position actual value [qc];Velocity actual value "
            "[rpm];Current actual value [mA];Target current [mA]\n"
        )
        i = 1000 * u[k]
        text(
            f / f"Recorder_{k + 1}.csv",
            head,
            [
                1000 * dt * np.arange(n),
                np.round(q[k, :, 0] * 2000 / 2 / np.pi),
                np.round(v[k, :, 0] * 30 / np.pi),
                np.round(i + r.normal(0, 15, n)),
                np.round(i),
            ],
            ";",
            "%.6g",
        )
    return Truth(
        "Time [ms]",
        dt,
        {"Position actual value [qc]": ("angular", "counts")},
        {"Target current [mA]": "mA"},
        {"Position actual value [qc]": "Velocity actual value [rpm]"},
        time_unit="ms",
        records=4,
        counts={"Position actual value [qc]": 2000},
    )


def dynamixel(f):
    r, dt, n = generator(302), 0.01, 1000
    u = np.round(levels(r, 5, n, 600, 70))
    q, v = simulate(arm, u / 300, dt, np.zeros((5, 1)), 4)
    for k in range(5):
        text(
            f / f"log_{k}.csv",
            "timestamp,present_position,present_velocity,present_temperature,goal_pwm\n",
            [
                1714644000 + 60 * k + dt * np.arange(n) + r.uniform(0, 4e-4, n),
                np.round(q[k, :, 0] * 4096 / 2 / np.pi) + 2048,
                np.round(v[k, :, 0] * 30 / np.pi / 0.229),
                31 + np.round(0.002 * np.arange(n)),
                u[k],
            ],
            fmt="%.14g",
        )
    return Truth(
        "timestamp",
        dt,
        {"present_position": ("angular", "counts")},
        {"goal_pwm": "1"},
        {"present_position": "present_velocity"},
        records=5,
    )


def mocap(f):
    dt, n = 0.005, 2000
    t = dt * np.arange(n)
    for k in range(4):
        r = generator(310 + k)
        q, _ = simulate(
            lambda q, v, u: -12 * np.sin(q) - 0.15 * v,
            np.zeros((1, n)),
            dt,
            np.array([[0.4 + 0.3 * k]]),
        )
        a = q[0, :, 0]
        head = (
            f"NO_OF_FRAMES\t{n}\nNO_OF_CAMERAS\t8\nNO_OF_MARKERS\t"
            "1\nFREQUENCY\t200\nNO_OF_ANALOG\t0\nDESCRIPTION\t--\n"
            "DATA_INCLUDED\t3D\nMARKER_NAMES\ttip\nFrame\tTime\t"
            "tip X\ttip Y\ttip Z\n"
        )
        text(
            f / f"swing{k + 1}.tsv",
            head,
            [
                np.arange(1, n + 1),
                t,
                612.3 + 815 * np.sin(a) + r.normal(0, 0.15, n),
                88.1 + r.normal(0, 0.15, n),
                1400 - 815 * np.cos(a) + r.normal(0, 0.15, n),
            ],
            "\t",
            "%.3f",
        )
    return Truth(
        "Time",
        dt,
        {"tip X": ("linear", "mm"), "tip Y": ("linear", "mm"), "tip Z": ("linear", "mm")},
        {},
        records=4,
    )


def oscilloscope(f):
    r, dt, n = generator(303), 0.002, 2500
    u = levels(r, 4, n, 6, 180)
    q, _ = simulate(arm, u / 3, dt, np.zeros((4, 1)))
    for k in range(4):
        text(
            f / f"scope_{k}.csv",
            "x-axis,1,2\nsecond,Volt,Volt\n",
            [
                dt * np.arange(n) - 2.5,
                2.5 + q[k, :, 0] * 5 / (300 * np.pi / 180) / 3 + r.normal(0, 0.002, n),
                u[k] + r.normal(0, 0.02, n),
            ],
            fmt="%+.5E",
        )
    return Truth("x-axis", dt, {"1": ("linear", "V")}, {"2": "V"}, records=4)


def matlab_timetable(f):
    r, dt, n = generator(304), 0.01, 900
    u = levels(r, 4, n, 2, 60)
    q, _ = simulate(arm, u, dt, np.zeros((4, 1)))
    for k in range(4):
        rows = "".join(
            f"{dt * i:.5g} sec,{np.degrees(q[k, i, 0]):.6g},{u[k, i]:.5g}\n" for i in range(n)
        )
        (f / f"tt{k}.csv").write_text("Time,theta_deg,u\n" + rows)
    return Truth("Time", dt, {"theta_deg": ("angular", "deg")}, {"u": "V"}, records=4)


def codesys(f):
    r, dt, n = generator(305), 0.004, 2500
    u = levels(r, 3, n, 8, 200)
    q, v = simulate(wheel, u, dt, np.zeros((3, 1)))
    for k in range(3):
        text(
            f / f"Trace{k}.csv",
            "Time(us);PLC_PRG.axis.fActPosition;PLC_PRG.axis.fActVelocity;"
            "PLC_PRG.axis.fSetTorque;PLC_PRG.axis.xError\n",
            [
                1e6 * dt * np.arange(n),
                np.degrees(q[k, :, 0]) % 360,
                np.degrees(v[k, :, 0]) + r.normal(0, 0.5, n),
                u[k],
                np.zeros(n),
            ],
            ";",
            "%.7g",
            ",",
        )
    p = "PLC_PRG.axis."
    return Truth(
        "Time(us)",
        dt,
        {p + "fActPosition": ("angular", "deg")},
        {p + "fSetTorque": "N m"},
        {p + "fActPosition": p + "fActVelocity"},
        time_unit="us",
        records=3,
    )


def pandas_index(f):
    r, dt, n = generator(306), 0.02, 800
    u = np.stack([levels(r, 4, n, 1.2, 40) for _ in range(2)], 2)
    q, v = simulate(joints, u, dt, np.zeros((4, 2)), 8)
    for k in range(4):
        t0 = datetime.datetime(2024, 5, 2, 10, k, 12, tzinfo=datetime.UTC)
        rows = [",timestamp,q1,q2,dq1,dq2,tau1,tau2"]
        for i in range(n):
            s = (t0 + datetime.timedelta(seconds=dt * i)).isoformat(timespec="microseconds")
            rows.append(
                f"{i},{s},"
                + ",".join(
                    f"{x:.6f}" for x in (*q[k, i], *(v[k, i] + r.normal(0, 0.01, 2)), *u[k, i])
                )
            )
        (f / f"episode_{k:03}.csv").write_text("\n".join(rows) + "\n")
    return Truth(
        "timestamp",
        dt,
        {"q1": ("angular", "rad"), "q2": ("angular", "rad")},
        {"tau1": "N m", "tau2": "N m"},
        {"q1": "dq1", "q2": "dq2"},
        records=4,
    )


def tidy(f):
    r, dt, n = generator(307), 0.01, 600
    u = levels(r, 4, n, 2, 60)
    q, _ = simulate(arm, u, dt, np.zeros((4, 1)))
    for k in range(4):
        rows = ["time,signal,value"]
        for i in range(n):
            rows.append(f"{dt * i:.3f},angle_deg,{np.degrees(q[k, i, 0]):.4f}")
            rows.append(f"{dt * i:.3f},motor_V,{u[k, i]:.4f}")
        (f / f"can_{k}.csv").write_text("\n".join(rows) + "\n")
    return Truth("time", dt, {"angle_deg": ("angular", "deg")}, {"motor_V": "V"}, records=4)


def overflow(f):
    r, dt, n = generator(308), 0.005, 1600
    out = "t_us,ticks,pwm\n"
    pwm = np.round(levels(r, 4, n, 255, 160))
    q, _ = simulate(wheel, pwm / 12, dt, np.zeros((4, 1)))
    for k in range(4):
        for i in range(n):
            out += (
                f"{500000 + round(1e6 * dt * i)},"
                f"{int(np.round(q[k, i, 0] * 1440 / 2 / np.pi)) % 65536},{int(pwm[k, i])}\n"
            )
    (f / "CAPTURE.TXT").write_text(out)
    return Truth(
        "t_us", dt, {"ticks": ("angular", "counts")}, {"pwm": "1"}, time_unit="us", records=-4
    )


def imu_turntable(f):
    r, dt, n = generator(309), 0.02, 1000
    s = np.round(1500 + levels(r, 5, n, 400, 60))
    q, v = simulate(wheel, (s - 1500) / 90, dt, np.zeros((5, 1)), 4)
    d = np.degrees(q[..., 0])
    for k in range(5):
        text(
            f / f"IMU{k:02}.csv",
            "timestamp_ms,yaw,pitch,roll,gyroZ_dps,servo_us\n",
            [
                20 * np.arange(n) + 1234,
                (d[k] + 180) % 360 - 180,
                r.normal(0.3, 0.05, n),
                r.normal(-0.8, 0.05, n),
                np.degrees(v[k, :, 0]) + r.normal(0, 0.3, n),
                s[k],
            ],
            fmt="%.5g",
        )
    return Truth(
        "timestamp_ms",
        dt,
        {"yaw": ("angular", "deg")},
        {"servo_us": "us"},
        {"yaw": "gyroZ_dps"},
        time_unit="ms",
        records=5,
    )


def hydraulic(f):
    r, dt, n = generator(320), 0.002, 3000
    u = levels(r, 4, n, 40, 250)
    q, _v = simulate(lambda q, v, u: 3 * u - 8 * v, u, dt, np.zeros((4, 1)))
    for k in range(4):
        head = "\ufeffZeit;Kolbenweg;Ventilstrom;Druck A;Druck B;Öltemperatur\ns;mm;mA;bar;bar;°C\n"
        text(
            f / f"Zylinder_Lauf{k + 1}.csv",
            head,
            [
                dt * np.arange(n),
                q[k, :, 0] + 200,
                u[k],
                90 + 0.5 * u[k] + r.normal(0, 0.4, n),
                90 - 0.5 * u[k] + r.normal(0, 0.4, n),
                41 + 0.0005 * np.arange(n),
            ],
            ";",
            "%.6g",
            ",",
        )
    return Truth("Zeit", dt, {"Kolbenweg": ("linear", "mm")}, {"Ventilstrom": "mA"}, records=4)


def logger_pro(f):
    dt, n = 0.05, 600
    t = dt * np.arange(n)
    for k in range(4):
        r = generator(330 + k)
        u = sines(r, 1, t, 1.5, 1.2)
        q, v = simulate(lambda q, v, u: (u - 9 * q - 0.2 * v) / 0.5, u, dt, np.zeros((1, 1)), 20)
        a = np.gradient(v[0, :, 0], dt)
        text(
            f / f"cart run {k + 1}.csv",
            "Latest: Time (s),Latest: Position (m),Latest: Velocity (m/s),"
            "Latest: Acceleration (m/s²),Latest: Force (N)\n",
            [t, q[0, :, 0] + 0.6, v[0, :, 0], a, u[0]],
            fmt="%.5f",
        )
    L = "Latest: "
    return Truth(
        L + "Time (s)",
        dt,
        {L + "Position (m)": ("linear", "m")},
        {L + "Force (N)": "N"},
        {L + "Position (m)": L + "Velocity (m/s)"},
        records=4,
    )


FIRST = [
    epos,
    dynamixel,
    mocap,
    oscilloscope,
    matlab_timetable,
    codesys,
    pandas_index,
    tidy,
    overflow,
    imu_turntable,
    hydraulic,
    logger_pro,
]


def daq(f):
    r, dt, n = generator(401), 0.002, 3000
    u = levels(r, 4, n, 8, 300)
    q, _ = simulate(wheel, u, dt, np.zeros((4, 1)))
    for k in range(4):
        text(
            f / f"AI_{k}.csv",
            "Sampled at 500 Hz\nTime (s),Dev1/ai0 (V),Dev1/ctr0 (ticks)\n",
            [
                dt * np.arange(n),
                u[k] + r.normal(0, 0.004, n),
                np.round(q[k, :, 0] * 2048 / 2 / np.pi),
            ],
        )
    return Truth(
        "Time (s)",
        dt,
        {"Dev1/ctr0 (ticks)": ("angular", "counts")},
        {"Dev1/ai0 (V)": "V"},
        records=4,
    )


def rostopic(f):
    r, dt, n = generator(402), 0.01, 1000
    u = np.stack([levels(r, 4, n, 1.2, 60) for _ in range(2)], 2)
    q, v = simulate(joints, u, dt, np.zeros((4, 2)), 4)
    for k in range(4):
        rows = [
            "%time,field.header.seq,field.header.stamp,field.header.frame_id,"
            "field.name0,field.name1,field.position0,field.position1,"
            "field.velocity0,field.velocity1,field.effort0,field.effort1"
        ]
        for i in range(n):
            s = 1_709_294_400_000_000_000 + k * 10**11 + round(1e9 * dt * i)
            rows.append(
                f"{s + 120345},{i},{s},,shoulder,elbow,"
                + ",".join(
                    f"{x:.7f}" for x in (*q[k, i], *(v[k, i] + r.normal(0, 0.01, 2)), *u[k, i])
                )
            )
        (f / f"joint_states_{k}.csv").write_text("\n".join(rows) + "\n")
    p = "field."
    return Truth(
        "%time",
        dt,
        {p + f"position{j}": ("angular", "rad") for j in (0, 1)},
        {p + f"effort{j}": "N m" for j in (0, 1)},
        {p + f"position{j}": p + f"velocity{j}" for j in (0, 1)},
        time_unit="ns",
        records=4,
    )


def lego(f):
    r, dt, n = generator(403), 0.02, 800
    u = np.round(levels(r, 4, n, 90, 40))
    q, _ = simulate(cart_and_pole, u[..., None] / 40, dt, np.zeros((4, 2)), 8)
    for k in range(4):
        text(
            f / f"run{k}.txt",
            "timer_ms motor_deg gyro_deg power_pct\n",
            [
                1000 * dt * np.arange(n),
                np.round(np.degrees(8 * q[k, :, 0])),
                np.round(np.degrees(q[k, :, 1])),
                u[k],
            ],
            " ",
            "%.0f",
        )
    return Truth(
        "timer_ms",
        dt,
        {"motor_deg": ("angular", "deg"), "gyro_deg": ("angular", "deg")},
        {"power_pct": "%"},
        time_unit="ms",
        records=4,
    )


def servo_drive(f):
    r, dt, n = generator(404), 0.001, 3000
    u = levels(r, 4, n, 3, 200)
    q, v = simulate(wheel, u * 2, dt, np.zeros((4, 1)))
    for k in range(4):
        text(
            f / f"trace{k}.csv",
            "Sample;Time[ms];Drive.MotorPosition[rev];Drive.MotorSpeed[1/min];"
            "Drive.Iq_ref[Arms];Drive.Iq_act[Arms]\n",
            [
                np.arange(n),
                np.arange(n),
                q[k, :, 0] / 2 / np.pi,
                v[k, :, 0] * 30 / np.pi,
                u[k],
                u[k] + r.normal(0, 0.05, n),
            ],
            ";",
            "%.6f",
        )
    return Truth(
        "Time[ms]",
        dt,
        {"Drive.MotorPosition[rev]": ("angular", "rev")},
        {"Drive.Iq_ref[Arms]": "A"},
        {"Drive.MotorPosition[rev]": "Drive.MotorSpeed[1/min]"},
        time_unit="ms",
        records=4,
    )


def helicopter(f):
    r, dt, n = generator(405), 0.01, 2000
    u = np.stack(
        [
            8 + sines(r, 4, dt * np.arange(n), 1.5, 0.6),
            8 + sines(r, 4, dt * np.arange(n), 1.5, 0.7),
        ],
        2,
    )
    q, _ = simulate(
        lambda q, v, u: np.stack(
            [
                0.4 * (u[:, 0] + u[:, 1] - 16) - 1.2 * q[:, 0] - 0.5 * v[:, 0],
                0.8 * (u[:, 0] - u[:, 1]) - 0.9 * q[:, 1] - 0.6 * v[:, 1],
                -0.8 * q[:, 1] - 0.4 * v[:, 2],
            ],
            1,
        ),
        u,
        dt,
        np.zeros((4, 3)),
    )
    d = np.degrees(q)
    for k in range(4):
        text(
            f / f"heli_{k}.csv",
            "t [s],elevation [deg],pitch [deg],travel [deg],Vf [V],Vb [V]\n",
            [dt * np.arange(n), *d[k].T, *u[k].T],
        )
    return Truth(
        "t [s]",
        dt,
        {x + " [deg]": ("angular", "deg") for x in ("elevation", "pitch", "travel")},
        {"Vf [V]": "V", "Vb [V]": "V"},
        records=4,
    )


def piezo(f):
    r, dt, n = generator(406), 0.0005, 4000
    u = 50 + sines(r, 4, dt * np.arange(n), 30, 8.0)
    q, _ = simulate(lambda q, v, u: 4e4 * (0.12 * u - q) - 80 * v, u, dt, np.full((4, 1), 6.0), 4)
    for k in range(4):
        text(
            f / f"P{k}.dat",
            "time_ms\tdisp_um\tvolt\n",
            [1000 * dt * np.arange(n), q[k, :, 0] + r.normal(0, 0.002, n), u[k]],
            "\t",
            "%.6f",
        )
    return Truth(
        "time_ms", dt, {"disp_um": ("linear", "um")}, {"volt": "V"}, time_unit="ms", records=4
    )


def crane_fr(f):
    r, dt, n = generator(407), 0.01, 1500
    u = levels(r, 4, n, 6, 120)
    q, _ = simulate(cart_and_pole, u[..., None] / 3, dt, np.zeros((4, 2)))
    for k in range(4):
        text(
            f / f"Essai{k + 1}.txt",
            "temps(s);x_chariot(m);angle_cable(deg);commande(V)\n",
            [dt * np.arange(n), q[k, :, 0], np.degrees(q[k, :, 1]), u[k]],
            ";",
            "%.5f",
            ",",
        )
    return Truth(
        "temps(s)",
        dt,
        {"x_chariot(m)": ("linear", "m"), "angle_cable(deg)": ("angular", "deg")},
        {"commande(V)": "V"},
        records=4,
    )


def rotor_speed(f):
    r, dt, n = generator(408), 0.05, 900
    u = np.round(50 + levels(r, 4, n, 40, 30))
    _q, v = simulate(
        lambda q, v, u: 5 * u - 0.9 * v - 0.0004 * v * abs(v), u, dt, np.zeros((4, 1)), 10
    )
    for k in range(4):
        text(
            f / f"thrust_stand_{k}.csv",
            "t,rpm,throttle\n",
            [dt * np.arange(n), v[k, :, 0] * 9.55 + r.normal(0, 3, n), u[k]],
            fmt="%.5g",
        )
    return Truth("t", dt, {"rpm": ("linear", "rpm")}, {"throttle": "%"}, records=4)


def exo_parquet(f):
    r, dt, n = generator(409), 0.005, 2000
    u = sines(r, 4, dt * np.arange(n), 1.2, 1.5)
    q, v = simulate(arm, u, dt, np.zeros((4, 1)))
    for k in range(4):
        pl.DataFrame(
            {
                "timestamp": 1_714_000_000_000_000_000 + np.arange(n) * 5_000_000 + k * 10**11,
                "hip_angle": q[k, :, 0],
                "hip_velocity": v[k, :, 0] + r.normal(0, 0.02, n),
                "motor_torque_cmd": 8 * u[k],
                "motor_torque_meas": 8 * u[k] + r.normal(0, 0.3, n),
                "phase": np.full(n, "stance"),
            }
        ).write_parquet(f / f"trial_{k}.parquet")
    return Truth(
        "timestamp",
        dt,
        {"hip_angle": ("angular", "rad")},
        {"motor_torque_cmd": "N m"},
        {"hip_angle": "hip_velocity"},
        time_unit="ns",
        records=4,
    )


def stage_rate(f):
    r, dt, n = generator(410), 0.001, 3000
    u = np.stack([levels(r, 4, n, 900, 150) for _ in range(2)], 2)
    q, _ = simulate(lambda q, v, u: 0.9 * u - 14 * v, u, dt, np.zeros((4, 2)))
    for k in range(4):
        text(
            f / f"Tisch_{k}.csv",
            "Datum: 12.03.2024\nAbtastrate: 1000 Hz\n\nX-Achse [µm];Y-Achse "
            "[µm];Strom X [mA];Strom Y [mA]\n",
            [*q[k].T, *u[k].T],
            ";",
            "%.3f",
            ",",
            encoding="cp1252",
        )
    return Truth(
        None,
        dt,
        {"X-Achse [µm]": ("linear", "um"), "Y-Achse [µm]": ("linear", "um")},
        {"Strom X [mA]": "mA", "Strom Y [mA]": "mA"},
        records=4,
    )


def tracker(f):
    dt, n = 1 / 30, 400
    t = dt * np.arange(n)
    for k in range(4):
        r = generator(420 + k)
        q, _ = simulate(
            lambda q, v, u: -9.8 * np.sin(q) - 0.1 * v,
            np.zeros((1, n)),
            dt,
            np.array([[0.5 + 0.3 * k]]),
            20,
        )
        a = q[0, :, 0]
        text(
            f / f"clip{k}.txt",
            "mass A\t\t\nt\tx\ty\n",
            [t, np.sin(a) + r.normal(0, 0.001, n), -np.cos(a) + r.normal(0, 0.001, n)],
            "\t",
            "%.6E",
        )
    return Truth("t", dt, {"x": ("linear", "m"), "y": ("linear", "m")}, {}, records=4)


def hex_counter(f):
    r, dt, n = generator(411), 0.01, 1200
    u = np.round(levels(r, 4, n, 200, 80))
    q, _ = simulate(wheel, u / 40, dt, np.zeros((4, 1)))
    for k in range(4):
        c = np.round(q[k, :, 0] * 1024 / 2 / np.pi).astype(int) % 1024
        (f / f"ser{k}.log.txt").write_text(
            "ms,enc,pwm\n" + "".join(f"{10 * i},0x{c[i]:03X},{int(u[k, i])}\n" for i in range(n))
        )
    return Truth(
        "ms",
        dt,
        {"enc": ("angular", "counts")},
        {"pwm": "1"},
        time_unit="ms",
        records=4,
        counts={"enc": 1024},
    )


SECOND = [
    daq,
    rostopic,
    lego,
    servo_drive,
    helicopter,
    piezo,
    crane_fr,
    rotor_speed,
    exo_parquet,
    stage_rate,
    tracker,
    hex_counter,
]


def bosch_can(f):  # exported from a CAN tool: dates in comments, blanks, long names
    r, dt, n = generator(501), 0.01, 1500
    u = levels(r, 4, n, 40, 120)
    q, v = simulate(lambda q, v, u: 0.8 * u - 3 * v - 0.5 * np.tanh(v), u, dt, np.zeros((4, 1)), 4)
    for k in range(4):
        head = (
            f"// date Fri Mar 1 10:0{k}:00 am 2024\n// base dec timestamps "
            "absolute\nTime[s],EPS::SteeringAngle[deg],EPS::SteeringRate[deg/s],"
            "EPS::AssistTorque_Req[Nm],EPS::AssistTorque_Act[Nm],EPS::Counter\n"
        )
        text(
            f / f"drive{k}.csv",
            head,
            [
                12.5 + dt * np.arange(n),
                np.degrees(q[k, :, 0] / 10),
                np.degrees(v[k, :, 0] / 10) + r.normal(0, 0.1, n),
                u[k] / 10,
                u[k] / 10 + r.normal(0, 0.05, n),
                np.arange(n) % 16,
            ],
        )
    p = "EPS::"
    return Truth(
        "Time[s]",
        dt,
        {p + "SteeringAngle[deg]": ("angular", "deg")},
        {p + "AssistTorque_Req[Nm]": "N m"},
        {p + "SteeringAngle[deg]": p + "SteeringRate[deg/s]"},
        records=4,
    )


def resolver_pm_pi(f):
    r, dt, n = generator(502), 0.002, 3000
    u = levels(r, 4, n, 4, 250)
    q, _ = simulate(wheel, u * 2, dt, np.zeros((4, 1)))
    for k in range(4):
        text(
            f / f"{k + 1:03}.dat",
            "# t  resolver  uq\n",
            [dt * np.arange(n), (q[k, :, 0] + np.pi) % (2 * np.pi) - np.pi, u[k]],
            " ",
            "%.6f",
        )
    return Truth("t", dt, {"resolver": ("angular", "rad")}, {"uq": "V"}, records=4)


def cnc_german(f):
    r, dt, n = generator(503), 0.004, 2500
    t = dt * np.arange(n)
    ref = 150 * moves(r, 4, t, 1.0)
    x = follow(ref, dt, 28.0)
    v = np.gradient(x, dt, axis=1)
    i = np.gradient(v, dt, axis=1) / 900 + v / 90 + 0.7 * np.tanh(v)
    for k in range(4):
        text(
            f / f"Aufzeichnung_{k + 1}.csv",
            "Zeit [ms];Istposition X [mm];Sollposition X [mm];Schleppabstand "
            "X [mm];Motorstrom X [A];Programmzeile\n",
            [1000 * t, x[k], ref[k], ref[k] - x[k], i[k], np.floor(t)],
            ";",
            "%.5f",
            ",",
            "latin-1",
        )
    return Truth(
        "Zeit [ms]",
        dt,
        {"Istposition X [mm]": ("linear", "mm")},
        {"Motorstrom X [A]": "A"},
        time_unit="ms",
        records=4,
    )


def unity_sim(f):  # quaternion-free: radians; camelCase
    r, dt, n = generator(504), 0.02, 900
    u = np.stack([levels(r, 5, n, 1.5, 40) for _ in range(1)], 2)
    q, v = simulate(cart_and_pole, u, dt, np.zeros((5, 2)), 8)
    for k in range(5):
        text(
            f / f"Episode_{k}.csv",
            "simTime,cartPosition,poleAngle,cartVelocity,poleAngularVelocity,appliedForce,reward\n",
            [dt * np.arange(n), *q[k].T, *v[k].T, u[k, :, 0], np.ones(n)],
        )
    return Truth(
        "simTime",
        dt,
        {"cartPosition": ("linear", "m"), "poleAngle": ("angular", "rad")},
        {"appliedForce": "N"},
        {"cartPosition": "cartVelocity", "poleAngle": "poleAngularVelocity"},
        records=5,
    )


def three_files(f):  # position, voltage, current: three loggers
    for k in range(4):
        r = generator(510 + k)
        n = 1500
        dt = 0.004
        u = levels(r, 1, n, 5, 120)
        q, v = simulate(wheel, u, dt, np.zeros((1, 1)))
        t = dt * np.arange(n)
        text(f / f"m{k}_encoder.csv", "time_s,angle_rad\n", [t + 0.02, q[0, :, 0]])
        text(f / f"m{k}_voltage.csv", "time_s,volts\n", [t[::3], u[0, ::3]])
        text(
            f / f"m{k}_current.csv",
            "time_s,amps\n",
            [t, 0.4 * u[0] - 0.02 * v[0, :, 0] + r.normal(0, 0.02, n)],
        )
    return Truth(
        "time_s", 0.004, {"angle_rad": ("angular", "rad")}, {"voltage/volts": "V"}, records=4
    )


def hdf5_sessions(f):
    import h5py

    r, dt, n = generator(505), 0.005, 1600
    u = levels(r, 4, n, 3, 100)
    q, v = simulate(arm, u, dt, np.zeros((4, 1)))
    for k in range(4):
        with h5py.File(f / f"sess{k}.h5", "w") as h:
            h["t"] = (dt * np.arange(n) * 1e6).astype("i8")
            h["t"].attrs["units"] = "us"
            h["enc/pos"] = np.round(q[k, :, 0] * 8192 / 2 / np.pi).astype("i4")
            h["enc/vel"] = v[k, :, 0]
            h["enc/vel"].attrs["units"] = "rad/s"
            h["drv/u_cmd"] = u[k]
            h["drv/u_cmd"].attrs["units"] = "V"
    return Truth(
        "t",
        dt,
        {"enc/pos": ("angular", "counts")},
        {"drv/u_cmd": "V"},
        {"enc/pos": "enc/vel"},
        time_unit="us",
        records=4,
        counts={"enc/pos": 8192},
    )


def shaker(f):  # accelerometer and displacement of a shaker, no position word
    r, dt, n = generator(506), 0.0005, 6000
    t = dt * np.arange(n)
    u = sines(r, 4, t, 5.0, 12.0)
    q, v = simulate(lambda q, v, u: u * 2 - 900 * q - 4 * v, u, dt, np.zeros((4, 1)), 2)
    for k in range(4):
        a = np.gradient(v[k, :, 0], dt)
        text(
            f / f"TEST{k}.txt",
            "Time\tForce\tDisp\tAccel\ns\tN\tmm\tm/s^2\n",
            [t, u[k], 1000 * q[k, :, 0] + r.normal(0, 0.002, n), a + r.normal(0, 0.1, n)],
            "\t",
            "%.6g",
        )
    return Truth("Time", dt, {"Disp": ("linear", "mm")}, {"Force": "N"}, records=4)


def drone_pitch(f):  # wrapped degrees 0..360, motor pwm in us, decimal seconds of day
    r, dt, n = generator(507), 0.01, 1200
    u = 1500 + levels(r, 4, n, 300, 100)
    q, _v = simulate(wheel, (u - 1500) / 60, dt, np.zeros((4, 1)), 4)
    for k in range(4):
        rows = ["clock,heading_deg,esc_us"]
        for i in range(n):
            s = 36000 + 60 * k + dt * i
            rows.append(
                f"{int(s // 3600):02}:{int(s % 3600 // 60):02}:{s % 60:06.3f},"
                f"{np.degrees(q[k, i, 0]) % 360:.2f},{u[k, i]:.0f}"
            )
        (f / f"flight{k}.csv").write_text("\n".join(rows) + "\n")
    return Truth("clock", dt, {"heading_deg": ("angular", "deg")}, {"esc_us": "us"}, records=4)


def potentiometer(f):  # ADC counts of a pot, 10 bit, not a full turn; Arduino plotter "name:value"
    r, dt, n = generator(508), 0.02, 800
    u = np.round(levels(r, 4, n, 120, 40))
    q, _ = simulate(arm, u / 90, dt, np.zeros((4, 1)), 8)
    for k in range(4):
        (f / f"serial{k}.txt").write_text(
            "".join(f"pot:{int(512 + q[k, i, 0] * 60)}\tpwm:{int(u[k, i])}\n" for i in range(n))
        )
    return Truth(None, dt, {"pot": ("angular", "counts")}, {"pwm": "1"}, records=4)


def feather_like_parquet(f):  # LeRobot-like names, degrees, float32, one file with episode_index
    r, dt, n = generator(509), 0.0333, 600
    u = np.stack([levels(r, 5, n, 1.2, 30) for _ in range(3)], 2)
    q, _v = simulate(joints, u, dt, np.zeros((5, 3)), 8)
    fr = pl.concat(
        [
            pl.DataFrame(
                {
                    "episode_index": np.full(n, k),
                    "frame_index": np.arange(n),
                    "timestamp": np.float32(dt * np.arange(n)),
                    **{f"joint_{j + 1}.pos": np.float32(np.degrees(q[k, :, j])) for j in range(3)},
                    **{f"joint_{j + 1}.torque": np.float32(u[k, :, j]) for j in range(3)},
                }
            )
            for k in range(5)
        ]
    )
    fr.write_parquet(f / "episodes.parquet")
    return Truth(
        "timestamp",
        dt,
        {f"joint_{j + 1}.pos": ("angular", "deg") for j in range(3)},
        {f"joint_{j + 1}.torque": "N m" for j in range(3)},
        records=5,
    )


def rig_with_json(f):  # a line of JSON before the table
    r, dt, n = generator(520), 0.01, 1000
    u = levels(r, 4, n, 3, 80)
    q, _ = simulate(slide, u, dt, np.zeros((4, 1)), 4)
    for k in range(4):
        text(
            f / f"rec{k}.csv",
            '{"rig": "sled", "operator": "mk", "fs_hz": 100}\nt,sled_position,drive_command\n',
            [dt * np.arange(n), q[k, :, 0], u[k]],
        )
    return Truth("t", dt, {"sled_position": ("linear", "m")}, {"drive_command": "1"}, records=4)


def spanish_excel(f):
    r, dt, n = generator(521), 0.05, 700
    u = levels(r, 4, n, 60, 20)
    q, _ = simulate(wheel, u / 30, dt, np.zeros((4, 1)), 10)
    for k in range(4):
        rows = ["Fecha;Hora;Posición (°);Consigna PWM (%);Corriente (A)"]
        for i in range(n):
            s = 32400 + 100 * k + dt * i
            clock = f"{int(s // 3600):02}:{int(s % 3600 // 60):02}:{s % 60:06.3f}"
            values = f"{np.degrees(q[k, i, 0]):.2f};{u[k, i]:.1f};"
            values += f"{abs(u[k, i]) / 30 + 0.05 * r.normal():.3f}"
            rows.append("01/03/2024;" + f"{clock};{values}".replace(".", ","))
        (f / f"Prueba {k + 1}.csv").write_bytes(("\r\n".join(rows) + "\r\n").encode("cp1252"))
    return Truth(
        "Hora", dt, {"Posición (°)": ("angular", "deg")}, {"Consigna PWM (%)": "%"}, records=4
    )


THIRD = [
    bosch_can,
    resolver_pm_pi,
    cnc_german,
    unity_sim,
    three_files,
    hdf5_sessions,
    shaker,
    drone_pitch,
    potentiometer,
    feather_like_parquet,
    rig_with_json,
    spanish_excel,
]


def gravity_deg(f):  # angle in degrees, no unit, small folder, name 'position'
    r, dt, n = generator(601), 0.01, 1200
    u = levels(r, 4, n, 2.5, 80)
    q, _ = simulate(arm, u, dt, np.zeros((4, 1)))
    for k in range(4):
        text(
            f / f"a{k}.csv",
            "Time,Position,Voltage\n",
            [dt * np.arange(n), np.degrees(q[k, :, 0]), u[k]],
        )
    return Truth("Time", dt, {"Position": ("angular", "deg")}, {"Voltage": "V"}, records=4)


def aerotech(f):
    r, dt, n = generator(602), 0.001, 3000
    t = dt * np.arange(n)
    ref = 25 * moves(r, 4, t, 1.0)
    x = follow(ref, dt, 45.0)
    v = np.gradient(x, dt, axis=1)
    i = np.gradient(v, dt, axis=1) / 600 + v / 60 + 0.3 * np.tanh(v)
    for k in range(4):
        text(
            f / f"Plot_{k}.dat",
            "! Automation1 data, sample rate 1 kHz\nTime (ms)\tX Position "
            "Command (mm)\tX Position Feedback (mm)\tX Position Error "
            "(mm)\tX Current Feedback (A)\n",
            [1000 * t, ref[k], x[k], ref[k] - x[k], i[k]],
            "\t",
            "%.6f",
        )
    return Truth(
        "Time (ms)",
        dt,
        {"X Position Feedback (mm)": ("linear", "mm")},
        {"X Current Feedback (A)": "A"},
        time_unit="ms",
        records=4,
    )


def mit_cheetah(f):
    r, dt, n = generator(603), 0.002, 2500
    u = np.stack([levels(r, 4, n, 1.2, 200) for _ in range(3)], 2)
    q, v = simulate(joints, u, dt, np.zeros((4, 3)))
    for k in range(4):
        np.savez(
            f / f"leg_{k}.npz",
            t=dt * np.arange(n),
            q=q[k],
            qd=v[k] + r.normal(0, 0.01, q[k].shape),
            tau_ff=u[k],
            tau_est=u[k] + r.normal(0, 0.1, u[k].shape),
        )
    return Truth(
        "t",
        dt,
        {f"q[{j}]": ("angular", "rad") for j in (1, 2, 3)},
        {f"tau_ff[{j}]": "N m" for j in (1, 2, 3)},
        {f"q[{j}]": f"qd[{j}]" for j in (1, 2, 3)},
        records=4,
    )


def dutch(f):
    r, dt, n = generator(604), 0.02, 900
    u = levels(r, 4, n, 9, 45)
    q, _ = simulate(arm, u / 3, dt, np.zeros((4, 1)), 4)
    for k in range(4):
        text(
            f / f"meting_{k}.csv",
            "tijd [s];hoek [graden];spanning [V]\n",
            [dt * np.arange(n), np.degrees(q[k, :, 0]), u[k]],
            ";",
            "%.4f",
            ",",
        )
    return Truth(
        "tijd [s]", dt, {"hoek [graden]": ("angular", "deg")}, {"spanning [V]": "V"}, records=4
    )


def influx(f):
    r, dt, n = generator(605), 0.05, 600
    u = levels(r, 4, n, 60, 20)
    q, _ = simulate(wheel, u / 30, dt, np.zeros((4, 1)), 10)
    for k in range(4):
        rows = ["time,field,value"]
        for i in range(n):
            t = 1_714_000_000_000 + k * 10**6 + 50 * i
            rows += [
                f"{t},angle_deg,{np.degrees(q[k, i, 0]):.3f}",
                f"{t},current_A,{abs(u[k, i]) / 40:.3f}",
                f"{t},pwm_pct,{u[k, i]:.1f}",
            ]
        (f / f"export{k}.csv").write_text("\n".join(rows) + "\n")
    return Truth(
        "time", dt, {"angle_deg": ("angular", "deg")}, {"pwm_pct": "%"}, time_unit="ms", records=4
    )


def encoder_volt_rows(f):
    for k in range(4):
        r = generator(610 + k)
        n = 1200
        dt = 0.01
        u = levels(r, 1, n, 5, 100)
        q, _ = simulate(wheel, u, dt, np.zeros((1, 1)))
        text(
            f / f"take{k} position.csv",
            "time,pos_deg\n",
            [dt * np.arange(n), np.degrees(q[0, :, 0])],
        )
        text(
            f / f"take{k} supply.csv",
            "time,V\n",
            [dt * np.arange(0, n, 2) + 1.7e9, u[0, ::2]],
            fmt="%.12g",
        )
    return Truth("time", 0.01, {"pos_deg": ("angular", "deg")}, {"supply/V": "V"}, records=4)


def crc_serial(f):
    r, dt, n = generator(606), 0.01, 1000
    u = np.round(levels(r, 4, n, 127, 60))
    q, _ = simulate(wheel, u / 30, dt, np.zeros((4, 1)))
    for k in range(4):
        (f / f"uart{k}.txt").write_text(
            "".join(
                f"$ENC,{10 * i},{int(q[k, i, 0] * 600 / 2 / np.pi)},{int(u[k, i])},"
                f"*{(i * 37) % 256:02X}\n"
                for i in range(n)
            )
        )
    return Truth(
        "2",
        dt,
        {"3": ("angular", "counts")},
        {"4": "1"},
        time_unit="ms",
        records=4,
    )


def ball_beam(f):
    r, dt, n = generator(607), 0.01, 900
    s = sines(r, 4, dt * np.arange(n), 0.1, 0.8)
    q, _ = simulate(lambda q, v, u: -6 * np.sin(u) - 0.3 * v - 3 * q, s, dt, np.full((4, 1), 0.02))
    for k in range(4):
        text(
            f / f"bb{k}.csv",
            "t (s), ball position (cm), beam angle (rad)\n",
            [dt * np.arange(n), 100 * q[k, :, 0], s[k]],
            ", ",
        )
    return Truth(
        "t (s)",
        dt,
        {"ball position (cm)": ("linear", "cm")},
        {"beam angle (rad)": "rad"},
        records=4,
    )


def imu_units(f):
    r, dt, n = generator(608), 0.005, 2000
    u = levels(r, 4, n, 2, 160)
    q, v = simulate(arm, u, dt, np.zeros((4, 1)))
    for k in range(4):
        text(
            f / f"imu{k}.csv",
            "us,enc_rad,gyro_rad_s,acc_x_g,acc_z_g,motor_cmd\n",
            [
                1e6 * dt * np.arange(n) + 4e6,
                q[k, :, 0],
                v[k, :, 0] + r.normal(0, 0.05, n),
                np.sin(q[k, :, 0]) + r.normal(0, 0.02, n),
                np.cos(q[k, :, 0]) + r.normal(0, 0.02, n),
                u[k],
            ],
            fmt="%.8g",
        )
    return Truth(
        "us",
        dt,
        {"enc_rad": ("angular", "rad")},
        {"motor_cmd": "1"},
        {"enc_rad": "gyro_rad_s"},
        time_unit="us",
        records=4,
    )


def wagon(f):
    r, dt, n = generator(609), 0.01, 1500
    u = levels(r, 4, n, 6, 120)
    q, v = simulate(cart_and_pole, u[..., None] / 3, dt, np.zeros((4, 2)))
    for k in range(4):
        text(
            f / f"Versuch{k}.csv",
            "t;Wagenposition;Pendelwinkel;Wagengeschwindigkeit;Winkelgeschwindigkeit;"
            "Motorspannung\ns;m;rad;m/s;rad/s;V\n",
            [dt * np.arange(n), *q[k].T, *v[k].T, u[k]],
            ";",
            "%.5f",
            ",",
        )
    return Truth(
        "t",
        dt,
        {"Wagenposition": ("linear", "m"), "Pendelwinkel": ("angular", "rad")},
        {"Motorspannung": "V"},
        {"Wagenposition": "Wagengeschwindigkeit", "Pendelwinkel": "Winkelgeschwindigkeit"},
        records=4,
    )


def gym_sincos(f):
    for k in range(5):
        r = generator(620 + k)
        u = levels(r, 1, 800, 2.0, 40)
        q, v = simulate(arm, u, 0.02, np.zeros((1, 1)), 4)
        th = q[0, :, 0]
        pl.DataFrame(
            {
                "step": np.arange(800),
                "cos_theta": np.cos(th),
                "sin_theta": np.sin(th),
                "theta_dot": v[0, :, 0],
                "action": u[0],
                "reward": -(th**2),
            }
        ).write_csv(f / f"episode{k}.csv")
    return Truth(
        None,
        0.02,
        {"cos_theta": ("angular", "rad")},
        {"action": "1"},
        {"cos_theta": "theta_dot"},
        records=5,
    )


def matlab_table(f):
    r, dt, n = generator(611), 0.01, 1000
    u = levels(r, 4, n, 3, 80)
    q, _ = simulate(arm, u, dt, np.zeros((4, 1)))
    for k in range(4):
        scipy.io.savemat(
            f / f"measurement_{k}.mat",
            {
                "data": {
                    "t": dt * np.arange(n)[:, None],
                    "phi": q[k],
                    "Ua": u[k][:, None],
                    "info": "rig 3",
                },
                "Ts": dt,
            },
        )
    return Truth("data.t", dt, {"data.phi": ("angular", "rad")}, {"data.Ua": "V"}, records=4)


FOURTH = [
    gravity_deg,
    aerotech,
    mit_cheetah,
    dutch,
    influx,
    encoder_volt_rows,
    crc_serial,
    ball_beam,
    imu_units,
    wagon,
    gym_sincos,
    matlab_table,
]

SETS = {"first": FIRST, "second": SECOND, "third": THIRD, "fourth": FOURTH}


def main() -> None:
    """Prints for each set how many of its drafts are right, and what the others say."""
    for name, laboratories in SETS.items():
        right = 0
        for laboratory in laboratories:
            with tempfile.TemporaryDirectory() as place:
                truth = laboratory(Path(place))
                try:
                    folder, files = list_logs([Path(place)])
                    draft = make_draft(folder, files, is_asking=False)
                    (folder / "dataset.toml").write_text(draft.text, encoding="utf-8")
                    wrong = differences(tomllib.loads(draft.text), truth, tn.load(folder))
                except tn.InputError as error:
                    wrong = [str(error)]
            right += not wrong
            for sentence in wrong:
                print(f"{laboratory.__name__}: {sentence}")
        print(f"{name} set: {right} of {len(laboratories)} right")


if __name__ == "__main__":
    main()
