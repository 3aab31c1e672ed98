"""Words in the names of columns and what they mean, in English and German.

A word of another language is here where logs were seen that have it.
Words are in lower case and without accents. German umlauts are spelled out: `hoehe`.
"""

from typing import Literal

Quantity = Literal[
    "time",
    "counter",
    "position",
    "velocity",
    "acceleration",
    "voltage",
    "duty",
    "control",
    "torque",
    "force",
    "current",
    "pressure",
    "error",
    "flag",
    "other",
]
Qualifier = Literal["command", "measured", "filtered", "model"]

_STRONG: dict[Quantity, str] = {
    "time": "time times zeit timestamp timestamps stamp clock millis micros uptime zeitstempel "
    "elapsed temps tijd nsec tsec tnsec",
    "counter": "index idx frame seq sequence row zeile nr episode iteration iter sample samples "
    "task lfd messpunkt",
    "position": "pos position positions angle angles winkel enc encoder encoders theta phi psi "
    "lage weg hub drehwinkel auslenkung deflection displacement height hoehe pitch roll yaw "
    "stellung poti potentiometer pot resolver geber drehgeber ink inkremente qpos elongation "
    "stroke azimuth elevation posicion hoek lage tilt heading",
    "velocity": "vel velo velocity velocities speed omega tacho dot qdot "
    "geschwindigkeit geschw drehzahl winkelgeschwindigkeit qvel rate punkt drehrate spd erpm "
    "derivative ableitung",
    "acceleration": "acc accel acceleration beschleunigung ddot qddot qacc accelerometer beschl",
    "voltage": "voltage spannung volt volts motorspannung ankerspannung uq vq ud vd ua vm spanning",
    "duty": "pwm duty dutycycle tastgrad throttle gas",
    "control": "control input eingang stellgroesse stellwert stellsignal action ctrl actuation "
    "stell aktion pid excitation anregung erregung",
    "torque": "torque torques tau moment drehmoment effort efforts motormoment trq couple",
    "force": "force forces kraft thrust schub antriebskraft",
    "current": "current currents strom motorstrom iq ankerstrom corriente",
    "pressure": "pressure druck",
    "error": "error err fehler regelabweichung schleppfehler schleppabstand deviation regelfehler",
    "flag": "status flag flags enable enabled ena mode modus fault alarm valid limit endschalter "
    "freigabe button taster bit done ready trigger trig estop switch homed zustand armed loop "
    "active usable saturated",
    "other": "temp temperature temperatur bat batterie bus dcbus vbus vbat ubat vcc vdd cpu noise "
    "battery batt fric friction reibung humidity rssi checksum crc supply versorgung latency "
    "reward energy energie hours tcp ee eef squared",
}
# the weight is lower for words that also mean something else
_WEAK: dict[Quantity, str] = {
    "time": "t sec secs ts date datetime datum uhrzeit clk fecha",
    "counter": "k step n id count tick cycle zyklus",
    "position": "q x y z s alpha beta gamma distance abstand dist delta joint gelenk pole "
    "pendulum pendel cart wagen laser sensor arm link beam ball disc scheibe th ang observation "
    "obs state",
    "velocity": "w v n qd xd xp rpm gyro tachometer",
    "acceleration": "a imu",
    "voltage": "u v",
    "control": "u in motor drive actuator antrieb aktor prop propeller ventil valve servo power",
    "torque": "m",
    "force": "f",
    "current": "i",
    "pressure": "p",
    "error": "e",
    "flag": "en on state",
}
_QUALIFIERS: dict[Qualifier, str] = {
    "command": "cmd command commanded setpoint sp target desired des ref reference soll sollwert "
    "vorgabe goal traj trajectory con fuehrungsgroesse request req set demand planned commands "
    "consigna",
    "measured": "meas measured applied act actual ist istwert mess messwert fb feedback raw roh m "
    "cell sensor",
    "filtered": "filt filtered filter smooth smoothed est estimated gefiltert lpf lp kf kalman hat "
    "obs observer",
    "model": "sim simulated model predicted pred",
}
_OTHERS = {
    "angle": "angle angles winkel theta phi psi alpha beta gamma pitch roll yaw drehwinkel th ang "
    "pole pendulum pendel joint gelenk shoulder elbow wrist hip knee schulter ellbogen encoder enc "
    "disc scheibe link drehgeber resolver azimuth elevation omega gyro tacho drehzahl rpm "
    "winkelgeschwindigkeit wheel rad_ rotor torque tau moment drehmoment hoek",
    "length": "x y z s weg hub lage cart wagen trolley katze slide schlitten carriage displacement "
    "height hoehe distance dist abstand auslenkung deflection laser ball kugel piston kolben sled "
    "stage gantry lift ram plunger stroke linear force kraft chariot length laenge",
    "container": "states state joint joints observation msg data value values log logs signals",
    "outside": "hand fahrer human operator interaction external extern disturbance stoer",
    "axis": "theta phi psi pitch roll yaw azimuth elevation",
    "any position": "pos position positions angle angles winkel lage enc encoder posicion hoek",
}

STRONG: dict[Quantity, set[str]] = {q: set(words.split()) for q, words in _STRONG.items()}
WEAK: dict[Quantity, set[str]] = {q: set(words.split()) for q, words in _WEAK.items()}
QUALIFIERS: dict[Qualifier, set[str]] = {q: set(words.split()) for q, words in _QUALIFIERS.items()}
ANGULAR, LINEAR = ({*_OTHERS[kind].split()} for kind in ("angle", "length"))
CONTAINERS = {*_OTHERS["container"].split()}  # where a column stands, not what it is
OUTSIDE = {*_OTHERS["outside"].split()}  # what acts on a machine beside its drives
AXES = {*_OTHERS["axis"].split()}  # a position alone; before another quantity what it is about
POSITION_WORDS = {*_OTHERS["any position"].split()}  # which quantity it is, but not of what
LETTERS = (
    "ä:ae ö:oe ü:ue ß:ss Ä:Ae Ö:Oe Ü:Ue φ:phi ϕ:phi θ:theta ϑ:theta ψ:psi ω:omega α:alpha β:beta "
    "γ:gamma τ:tau Δ:delta ẋ:xdot \u0307:dot"
)
"""How letters with accents and Greek ones are spelled."""

# units by quantity, as cards have them, and how else they are spelled
UNITS = """
position:rad:radian radians
position:deg:degree degrees grad grd ° graden
position:rev:revs turns turn umdr umdrehungen revolutions rotations rot
position:mrad:
position:m:meter metre meters metres
position:cm:
position:mm:
position:um:µm μm
position:in:inch inches
position:counts:cnt cnts count tick ticks pulses inc incs ink inkr inkremente increments impulse \
steps lsb
velocity:rpm:1/min u/min min^-1 min-1 rev/min r/min rev_min u_min upm 1_min
velocity:km/h:kmh kph
velocity:rev/s:rps hz_rev
velocity:rad/s:rads
velocity:m/s:mps
velocity:deg/s:dps
acceleration:g:
acceleration:mg:
voltage:V:volt volts
voltage:mV:
current:A:amp amps ampere
current:mA:
duty:%:pct percent prozent
force:N:newton newtons
force:kN:
force:mN:
torque:N m:nm n*m n_m newtonmeter
torque:mN m:mnm mn*m
torque:N cm:ncm n*cm
pressure:bar:
pressure:Pa:
pressure:psi:
time:s:sec secs second seconds sek sekunden
time:ms:msec millis millisec millisecs millisecond milliseconds millisekunden
time:us:usec micros microseconds mikrosekunden µs μs
time:ns:nsec nsecs nanos nanoseconds nanosekunden
other:degC:°c c celsius
other:K:
other:Hz:
other:W:
other:kg:
other:g/s:
other:l/min:
other:dB:
other:lx:lux
"""
