"""What decides in the check of records."""

from dataclasses import dataclass


@dataclass(frozen=True)
class CheckLevels:
    """Sizes from which on a property of records is a finding.

    They were set on records of twelve simulated machines with planted faults, and of the measured
    ones that were at hand, so that none of these has a false severe finding; what they cost and
    find since then is in the reference page of findings.

    Attributes:
        stencil: samples; fewer have no velocities.
        wild: share of the periods in which an angle that is sampled well does not move by a
            quarter turn.
        other_period: relative; velocities are wrong by it, accelerations by twice it.
        far_period: the same, of a severe finding.
        longest_clock: s; a mechanism that needs a shorter period is rare.
        long_gap: periods; of a shorter one little motion is lost.
        fast: of the deviation of a position, for changes from sample to sample that are looked at.
        few_samples: in a period of the strongest oscillation.
        fewer_samples: the same, of a warning.
        ringing: periods, after which an oscillation that is none has decayed.
        other_count: relative; an encoder count this far from the declared one is another.
        fewest_counts: levels of a position that tell the count of its encoder.
        main_jumps: of the largest jump, for jumps that count; a bad row beside it has smaller ones.
        most_jumps: share of these jumps that have one size where it means something.
        same_jump: relative difference of jumps from the span of a counter or a turn.
        often: jumps of a size that are no chance; a bad row has two.
        counts: a change of so many is none of quantisation.
        step: times the changes that an input rarely exceeds.
        frozen: equal samples of a sensor that froze.
        clipped: equal samples at an end of a sensor's range.
        settled: counts within which an interpolated constant stays.
        interpolated: samples at its ends, which interpolation has bent.
        fewest_velocities: samples of a velocity column that is compared with the slope.
        lag_of_velocity: samples by which a velocity column is late.
        lag_share: the same in periods of the motion.
        most_lags: samples; no filter of a velocity makes more.
        gain_of_velocity: relative, beyond what the correlation leaves open.
        other_gain: the same, of a severe finding.
        same_velocity_unit: relative difference of a gain from that of another unit.
        low_correlation: of a column that is not the slope of the positions.
        high_correlation: of one that is.
        own_residual: share of a velocity column that the slope of its own positions does not
            explain, by that of others; joints that move together have velocities that are alike.
        beyond_limits: of the range between the limits of an input.
        run: samples of a stretch that is looked up in other records.
        changes: of them, in which something moves.
        fewest_shared: samples in motion that two records do not share by chance.
        least_shared: the same as a share of the shorter record.
        alike: of the deviation; two runs of one experiment differ by more, as a rule.
        digits: of the range; positions that differ by less are equal.
        poor: times the usual residual of a record that is looked at closely.
        drop: of a residual, which is left where a fault is undone or a model is the right one.
        usual: times the usual residual of the others, which a model that holds may leave.
        clear: of a residual, which leaves no doubt, however large that is.
        unexplained: of the accelerations, which a model that holds leaves at most.
        clearer: of the residual without a fault that has no size, for one that has.
        promising: of a residual, from which on a size is refined.
        poorer: times the usual residual of a record of another machine.
        novel: times the others' motion, beyond which a model extrapolates.
        fewest_files: files that can be compared with one another.
        most_suspects: files that are looked at closely, between two faults that are found.
        usual_gain: logarithm by which a gain is off one of a unit or of counted edges.
        same_unit: relative difference of a gain from that between two units.
        drop_by_scale: of what a model leaves, which the true scale of an angle leaves.
        least_by_scale: of the accelerations, which that scale explains beside all others.
        same_sensor: counts, or deviations of the noise, by which two columns of one sensor differ.
        same_share: the same as a share of their motion.
        most_samples: of a record, for the model of the motion; of longer ones blocks are taken.
        block: samples.
        windows: of a record, about.
        share: half the width of a window, in periods of the fast part of the motion.
        widened: the same, at most, where noise needs wider windows.
        narrowest: samples of half a window.
        widest: the same, at most.
        segment: samples of a spectrum.
        noise: share of noise in averaged accelerations that windows are widened to.
        small_range: range of an angle that a spring may hold [rad].
        few_coordinates: so many have products of velocities, too.
        creep: of the usual speed; the sign of a velocity is smooth within.
        ridge: of the mean square of a regressor.
        fewest_windows: windows of a file that is compared with others.
    """

    stencil: int = 5
    wild: float = 0.05
    other_period: float = 0.003
    far_period: float = 0.02
    longest_clock: float = 5e-5
    long_gap: float = 4.5
    fast: float = 0.3
    few_samples: float = 8.0
    fewer_samples: float = 5.0
    ringing: float = 1.5
    other_count: float = 0.01
    fewest_counts: int = 10
    main_jumps: float = 0.5
    most_jumps: float = 0.7
    same_jump: float = 0.02
    often: int = 3
    counts: float = 5.0
    step: float = 5.0
    frozen: int = 5
    clipped: int = 4
    settled: float = 0.05
    interpolated: int = 4
    fewest_velocities: int = 40
    lag_of_velocity: float = 0.8
    lag_share: float = 0.01
    most_lags: int = 12
    gain_of_velocity: float = 0.05
    other_gain: float = 0.2
    same_velocity_unit: float = 0.1
    low_correlation: float = 0.5
    high_correlation: float = 0.9
    own_residual: float = 5.0
    beyond_limits: float = 0.01
    run: int = 16
    changes: int = 8
    fewest_shared: int = 50
    least_shared: float = 0.1
    alike: float = 0.003
    digits: float = 1e-6
    poor: float = 2.0
    drop: float = 0.3
    usual: float = 3.0
    clear: float = 0.04
    unexplained: float = 0.7
    clearer: float = 0.7
    promising: float = 0.75
    poorer: float = 6.0
    novel: float = 4.0
    fewest_files: int = 3
    most_suspects: int = 3
    usual_gain: float = 0.08
    same_unit: float = 0.15
    drop_by_scale: float = 0.4
    least_by_scale: float = 0.05
    same_sensor: float = 2.0
    same_share: float = 0.1
    most_samples: int = 16_000
    block: int = 1000
    windows: int = 250
    share: float = 0.1
    widened: float = 0.4
    narrowest: int = 4
    widest: int = 60
    segment: int = 1024
    noise: float = 0.2
    small_range: float = 3.0
    few_coordinates: int = 2
    creep: float = 0.03
    ridge: float = 1e-5
    fewest_windows: int = 20


LEVELS = CheckLevels()
