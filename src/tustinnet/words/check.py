"""Sentences on what the check of records finds; the line of the card comes with each."""

from tustinnet.words.sentence import note, severe, warning

_LEFT = "the model of the others leaves {residual:.2g} of its residual then"

CHECK = {
    # --- of a record ---
    "period": warning(
        "the log has another sampling period than the card",
        size="{milliseconds:.5g} ms against dt = {declared:.5g} ms: {deviation:+.1%}",
    ),
    "time unit": warning(
        "the timestamps look like {unit}, not {declared}",
        size="they are {step:.4g} apart, which makes a period of {period:.3g} s",
    ),
    "gap": warning(
        "samples are missing",
        size="{count:gap} of up to {milliseconds:.4g} ms, {samples:.0f} samples, {treatment}",
    ),
    "sampling": warning(
        "{channel} is sampled slowly for its motion",
        size="{samples:.1f} samples in a period of {milliseconds:.3g} ms, 10 or more are usual",
    ),
    "dead sensor": warning(
        "{channel} never changes[[{flickers} by more than one count]]",
        size="{value:.4g} {unit} in all {samples:sample}",
    ),
    "fast angle": warning(
        "{channel} moves more than a quarter turn in {share:.0%} of the periods",
        size="another unit, or sampled too slowly?",
    ),
    "angle unit": severe(
        "{channel} moves like an angle in another unit than declared",
        size="its range is {extent:.3g} rad; with angles {factor:.3g} times as large the model "
        "leaves {after:.2%} of the accelerations, not {before:.2%}",
    ),
    "angle scale": warning(
        "{channel} moves like an angle in another scale than declared, or behind a gear",
        size="its range is {extent:.3g} rad; with angles {factor:.3g} times as large the model "
        "leaves {after:.2%} of the accelerations, not {before:.2%}",
    ),
    "jump": warning(
        "{channel} jumps at sample {rows}: bad rows, lost counts, runs in a row?",
        size="{count:jump} of up to {largest:.5g} {unit}[[, {counts:.0f} counts]]",
    ),
    "counter": warning(
        "{channel} jumps at sample {rows}: {cause}",
        size="{count:jump} of up to {largest:.5g} {unit}[[, {counts:.0f} counts]]",
    ),
    "encoder wraps": note("an encoder that wraps"),
    "degrees wrap": note("an angle in degrees that wraps"),
    "radians wrap": note("an angle in radians that wraps"),
    "counter overflows": note("a counter of {bits} bits that overflows"),
    "frozen sensor": warning(
        "{channel} repeats a value while it moves",
        size="{count:time}, {samples:sample}, {milliseconds:.4g} ms at a stretch",
    ),
    "clipped sensor": warning(
        "{channel} stays at an end of its range, reached and left at speed",
        size="{count:time}, {samples:sample}, {milliseconds:.4g} ms at a stretch",
    ),
    "encoder count": warning(
        "{channel}: encoder count {count:.5g} {unit} found",
        size="{declared:.5g} {unit} declared, {ratio:.4g} times",
    ),
    "padded velocity": warning(
        "velocity columns are padded with zero rows",
        size="{first} at the beginning, {last} at the end, in which the positions move, "
        "so that all velocities are taken from the positions",
    ),
    "velocity": warning(
        "{channel}: the velocity column {relation} the change of the positions", size="{how}"
    ),
    "has outliers": note("has outliers at sample {rows}, unlike"),
    "by up to": note("by up to {largest:.3g}"),
    "is that of another": note("is that of {other}, not"),
    "correlates with another": note("r = {correlation:.2f}, with that {other:.3f}"),
    "has the opposite sign": note("has the opposite sign of"),
    "disagrees": note("disagrees with"),
    "has another scale": note("has another scale than"),
    "times the slope": note("{gain:.4g} times the slope, r = {correlation:.3f}"),
    "lags": note("lags behind"),
    "milliseconds": note("{milliseconds:.3g} ms, {samples:.1f} samples"),
    "spike": warning(
        "{channel} has spikes at sample {rows}",
        size="by {largest:.3g} {unit}, others stay within {usual:.3g}: bad rows?",
    ),
    "limits": warning(
        "{channel} goes beyond its limits: the actuator gave less than the log says",
        size="by {beyond:.3g} {unit} in {samples:sample}, {share:.1%}",
    ),
    # --- between records ---
    # a size may stand for a change of the machine; a sign and a swap cannot
    "sign": severe("{channel} has the opposite sign in this record", size=_LEFT),
    "swap": severe("{channels:and} are swapped in this record", size=_LEFT),
    "gain": warning(
        "{channel} has another gain in this record[[{may_be_machine}, or the record is of another "
        "machine or payload]]",
        size="{gain:.4g} times that in the others; " + _LEFT,
    ),
    "offset": warning(
        "{channel} has another zero in this record", size="{offset:+.3g} {unit}; " + _LEFT
    ),
    "lag": warning(
        "{channel} comes {direction} in this record[[{alone}, or the positions {opposite}]]",
        size="by {milliseconds:.3g} ms, {samples:.1f} samples; " + _LEFT,
    ),
    "record period": warning(
        "the record is of another sampling period, or of a machine that is as much slower",
        size="{milliseconds:.4g} ms against {declared:.4g} ms; " + _LEFT,
    ),
    "other machine": warning(
        "the record is of another machine, payload or friction, or an input acted otherwise than "
        "logged, as beyond the limits of its amplifier",
        size="the model of the others leaves {of_others:.3g} times the usual residual, one of its "
        "own {of_own:.3g} times",
    ),
    "overlap": warning(
        "two records share rows of a file", size='{rows} rows of "{file}" from row {begin} on'
    ),
    "copy": warning(
        "[[{is_whole}two records are equal]][[{is_part}two records share samples]]",
        size="{samples} of {total} samples are the same[[, {later:+.3g} s later]]",
    ),
    "near copy": warning(
        "two records are nearly equal",
        size="they differ by {difference:.2%} of their deviation: a rounded copy, or one "
        "experiment done twice?",
    ),
    # --- of all ---
    "still input": warning(
        "{channel} moves in no record", size="{value:.4g} {unit} in all {samples:sample}"
    ),
    "same sensor": warning(
        "{other} and {channel} move as one: one sensor, or joints that never move apart?",
        size="{channel} is {gain:.4g} times the other within {error:.2g} {unit}",
    ),
    "assumed": note(
        "the {keys:and}[[ of {owner:and}]] {verb} assumed to be {values:and}", size="{evidence}"
    ),
    "assumed together": note(
        "the files of {channel} were assumed to begin together with those of the records",
        size="their clocks have nothing in common",
    ),
}
