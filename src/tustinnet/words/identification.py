"""Sentences on fits: why they ended, and what identified parameters are worth."""

from tustinnet.words.sentence import note, warning

_FEW = ", with too few records ({records})"

_FALLS = (
    "; the force that is missing at '{at}' then falls from {before:percent.3g} to "
    "{after:percent.3g}"
)

IDENTIFICATION = {
    # --- why a search ended ---
    "diverged": warning(
        "diverged: the simulations with the estimated values diverge",
        "look at the signs in the data card and in the system file, and at the ranges",
    ),
    "converged": note("converged: no step promises a lower cost ({iterations:iteration})"),
    "converged forces": note("converged after {steps:step} of inverse dynamics"),
    "not converged forces": warning("not converged after {steps:step} of inverse dynamics"),
    "stalled": warning(
        "stalled: no step lowers the cost though the gradient is not zero",
        "start from other values, or look for a jump in the energies or forces",
    ),
    "slow": warning(
        "ended: ten steps together lowered the cost by less than its tolerance",
        "the records hardly tell some parameters, or the model lacks much: see the residuals",
    ),
    "limit of iterations": warning(
        "stopped at the limit of {iterations:iteration} while still falling",
        "allow more (search.iterations), or start from other values",
    ),
    "limit of iterations lost": warning(
        "not converged after {iterations:iteration}; the simulations of {records} miss by more "
        "than the records vary",
        "compare them over less than {seconds:.2g} s at once (search.horizon={shorter:.2g}), or "
        "leave them out",
    ),
    "out of time optional": note(
        "out of time: stopped at its time limit among the optional terms; the values are those of "
        "a fit to {stage}"
    ),
    "out of time": note(
        "out of time: stopped at its time limit after stage {finished} of {stages} ({stage})"
    ),
    # --- of a search by simulations ---
    "sign reversed": warning(
        "the sign of {alternatives:quoted or-of} is probably reversed: turned around, the "
        "equations of motion explain the records clearly better",
        "check the data card or the system's signs",
    ),
    "segments": note("{records}: fitted over segments of {seconds:.2g} s"),
    "segments diverge": note(
        "{records}: simulations of longer segments diverge, fitted over segments of {seconds:.2g} s"
    ),
    "segments errors grow": note(
        "{records}: errors of the start grow too much beyond about {seconds:.2g} s, fitted over "
        "segments of {seconds:.2g} s"
    ),
    "whole records": note("{records}: fitted as a whole"),
    "validation segments": note(
        "validation records are scored over segments of {seconds:.2g} s, each from the start "
        "'{start}'"
    ),
    "groups disagree": warning(
        "the records of {one} and {other} disagree about `{parameter}` ({value:.4g} +- "
        "{error:.2g} against {other_value:.4g} +- {other_error:.2g}[[ {unit}]])",
        'declare it per="{group}"',
    ),
    "record contradicts": warning(
        "record '{one}' and {other} disagree about `{parameter}` ({value:.4g} +- {error:.2g} "
        "against {other_value:.4g} +- {other_error:.2g}[[ {unit}]])",
        "either of them may be wrong, or the model lacks what matters in some; a record that was "
        "made otherwise gets a group",
    ),
    "at bound": note(
        "'{parameter}' is at its {bound} bound ({value:.4g} {unit}[[; range: {basis}]]): the "
        "records do not determine it, or the range is wrong"
    ),
    "at bound misfit": warning(
        "'{parameter}' is at its {bound} bound ({value:.4g} {unit}[[; range: {basis}]]): the "
        "model lacks something, or the range is wrong"
    ),
    "masses at bound": warning(
        "the masses of {count} of {total} links are at their {bound} bound: inputs or positions "
        "are probably in another unit, as motor currents without a gain, or degrees",
        "`scale` and `unit` in the card, or `motor_constants=` of `load_robot`",
    ),
    "breakaway sticks": warning(
        "the breakaway friction beside it then stands for a joint that sticks, which the rounded "
        "sign of the model does not",
        "trust neither, and compare free runs with those of 'curve'",
    ),
    "vanished": note("'{parameter}' is 0, its lower bound: the records show nothing of it"),
    "vanished misfit": warning(
        "{parameters:quoted}: 0, their lower bound; that says nothing of the machine as long as "
        "the model misses more than the sensors' noise",
        "[[{advises_forces}try a force behind the recipe's name: '+ constant' or '+ curve']]",
    ),
    "wider ranges": note(
        "a system file moves bounds: {call}; values that then go on to the new bound say that the "
        "model lacks something"
    ),
    "known beside": note("{parameter} +- {spread:.2g} (by {fixed})"),
    "known beside fixed": note(
        "errors are those beside the fixed values; with what is not known of these they are "
        "{known}",
        "records with a known load, with two loads, or with a measured torque or current tell more",
    ),
    "stretch": note("'{record}' {begin:.4g}..{end:.4g} s"),
    "stretches weigh little": warning(
        "residuals of {count} stretches weigh less than half of the others: {stretches}"
        "[[ and {more} more]]",
        "look at the records there",
    ),
    "no effect on simulations": warning(
        "'{parameter}' has hardly any effect on the simulations", "fix it"
    ),
    "badly conditioned": warning(
        "badly conditioned ({condition:.1g}): {parameters} can change together with hardly any "
        "effect on the simulations",
        "fix one of them or record motion that tells them apart",
    ),
    "no effect": warning(
        "'{fixed}' has no effect on these records: it was fixed at its first value"
    ),
    "only ratios": warning(
        "only ratios of {parameters:and} can be identified, as multiplied by one factor they give "
        "the same simulation: '{fixed}', which is known best, was fixed at its first value"
    ),
    "not separate": warning(
        "{parameters:and} are not identifiable separately, as changed together (relatively by "
        "{changes:+.3g}) they give the same simulation: '{fixed}', which is known best, was fixed "
        "at its first value"
    ),
    "combinations without effect": warning(
        "{count} combinations of the {total} parameters have no effect on these records; the best "
        "known one of each was fixed at its first value: {fixed}"
    ),
    "identifiability unchecked": warning(
        "simulations with the first values diverge, in 16 steps a period too; identifiability was "
        "not checked",
        "first values nearer to the machine's, `changes=` model.begin.NAME=VALUE",
    ),
    "residuals of counts": note(
        "residuals are no larger than the encoders' quantisation: nothing is missing"
    ),
    "residuals of nothing": note(
        "residuals are no larger than a millionth of the motion: nothing is missing"
    ),
    "residuals correlated": warning(
        "residuals are [[{ratio:.0f} times the encoders' quantisation and ]]alike from sample to "
        "sample (correlation {correlation:.2f}): something is not modelled, and errors from J'J "
        "are too small"
    ),
    "residuals independent": note(
        "residuals are [[{ratio:.0f} times the encoders' quantisation and ]]independent from "
        "sample to sample"
    ),
    "errors of records": note("trust the errors from how the {records:record} disagree"),
    "errors of segments": note(
        "the errors are those from how the {segments:segment} disagree" + _FEW + " for others"
    ),
    "errors of residuals": note("the errors are those from J'J" + _FEW + " for others"),
    "errors unknown": warning("errors are too small" + _FEW + " to say by how much"),
    "term at": note("{term} at {value:g}"),
    "optional terms": note("optional terms: all {offered} kept ({terms})"),
    "optional terms dropped": note(
        "optional terms: {kept} of {offered} kept ([[{terms}]][[{none}none]]); without any of the "
        "others, records that are left out are explained as well"
    ),
    "optional terms left": note(
        "optional terms: {remaining} of {offered} are left; the time limit ended the search for "
        "those that are not needed"
    ),
    "changed": note("{parameter} {before:.3g} -> {after:.3g}"),
    "refitted": note(
        "the parameters of the model were refitted to free runs of the training records from "
        "{start}: their mean RMSE went from {before:.3g} to {after:.3g}"
        "[[; {changes} changed most]]"
    ),
    "refit not needed": note(
        "free runs of the training records from {start} gain less than {share:.0%} by a refit: the "
        "parameters are as identified"
    ),
    "not refitted": note("no refit to free runs: {why}"),
    # --- of a controller in the loop ---
    "controller in loop": note(
        "the controller of the data card is in the loop: set points drive the simulations"
        "[[, the recorded inputs ({inputs}) {used}]]"
    ),
    "controller gain": note("{gain} {value:.4g} ± {error:.1g} {unit}"),
    "controller gains": note("gains of the controller, by the recorded inputs: {gains}"),
    "controller unexplained": note(
        "the controller's law leaves [[{low:percent} to ]]{high:percent} of the recorded inputs "
        "unexplained"
    ),
    "controller other law": warning(
        "the controller computed {inputs} otherwise than the data card says",
        "check its set points, their units, its gains, and whether a feed-forward, an integral or "
        "a delay is missing",
    ),
    # --- of inverse dynamics ---
    "of file": note("{remark}"),
    "missing forces": note(
        "forces that are missing on the {split} records, up to {cutoff:.3g} Hz: {joints}"
        "[[; {mean:percent.3g} on the mean, {moving:percent.3g} while they move, "
        "{by_least_squares:percent.3g} by least squares alone, {by_file:percent.3g} by the first "
        "values]]"
    ),
    "missing force": note("{joint} {share:percent.3g} ({force:.3g} {unit})"),
    "missing force undriven": note("{joint} not driven, {force:.3g} {unit} missing"),
    "force kept": note("{force} kept ({before:percent.3g} to {after:percent.3g})"),
    "force not kept": note("{force} not kept ({before:percent.3g} to {after:percent.3g})"),
    "forces tried": note("forces tried, by what is missing of those that were left out: {trials}"),
    "base parameters": note(
        "{rank} combinations of the {total} parameters change the forces (base parameters)"
        "[[; the records say little of {uninformed}, which stay near their nominal values]]"
    ),
    "holds": note(
        "{joint} {dry:.3g} ± {error:.2g} {unit}, {level:.3g} of it within {travel:.3g} "
        "{travel_unit}"
    ),
    "holds at rest": note(
        "dry friction (95 %), `coulomb` and the levels of `slip`, which hold at rest, together: "
        "{joints:each}"
    ),
    "centre": note("{value:.3g} ± {error:.2g}"),
    "carries": note(
        "'{link}' carries {mass:.4g} ± {error:.2g} kg (95 %) more in records of {group} than in "
        "those of {lightest}, centre at {center} m"
    ),
    "far angle": warning(
        "{coordinate} moves from {low:.3g} to {high:.3g} {unit}, and from {least:g} to {most:g} "
        "by {file}: degrees taken for rad, the angle of a motor before its gear, or another "
        "column? `unit` and `scale` in the card"
    ),
    "far position": warning(
        "{coordinate} moves from {low:.3g} to {high:.3g} {unit}, and from {least:g} to {most:g} "
        "by {file}: another unit, or another column? `unit` and `scale` in the card"
    ),
    "force beyond limit": warning(
        "{input} is up to {force:.3g} {unit}, and {coordinate} has {most:g} {unit} by {file}: "
        "another unit, as mN m, or a motor constant or gear ratio too large? `scale` in the card"
    ),
    "force at limit": warning(
        "{input} is up to {force:.3g} {unit}, and {coordinate} has {most:g} {unit} by {file}: "
        "what a controller asked for is not what a motor gives at its limit",
        "take the column of what it gave, or correct the file",
    ),
    "forces by factor": warning(
        "the forces of {joints:quoted and} explain the motion as {factor:.3g} times what the "
        "columns say: {cause}" + _FALLS,
        "`scale` in the card, times {factor:.3g}",
    ),
    "forces small": warning(
        "by the first values {least:.2g} to {most:.2g} times the recorded forces are missing at "
        "all joints: the torque of a motor before its gear, or another unit?",
        "`scale` in the card; masses alone explain it only where the file is that far off",
    ),
    "position in other unit": warning(
        "the position of {joints:quoted and} explains the motion as {unit}" + _FALLS,
        'unit = "{key}" in the card',
    ),
    "columns exchanged": warning(
        "the {what} of {joints:quoted and} are probably exchanged" + _FALLS,
        "look at the columns in the card",
    ),
    "column sign reversed": warning(
        "the sign of {what:or-of} of {joints:quoted and} is probably reversed" + _FALLS,
        "sign = -1 in the card, or without it where it is there already",
    ),
    "group apart": warning(
        "records of {group} = {value}: {before:percent.3g} of the forces are missing by parameters "
        "of the others, {after:percent.3g} by those of their own",
        '`per=` of `load_robot`, as {{LINK: "{group}"}}, where a link carries something else',
    ),
    "record apart": warning(
        "{before:percent.3g} of the force at {joint} are missing, and {after:percent.3g} without "
        "{without:quoted and}: another payload, zero or sign there?",
        "a group of its own, `per=` of `load_robot` for what is carried, or leave it out",
    ),
    "forces missing": warning(
        "most of the force at {joints} is missing",
        "look at the columns there (sign, unit, gear ratio, zero of the position, exchanged with "
        "those of another joint), and at the file: axes, masses, gravity",
    ),
    # --- of trainings ---
    "still improving": warning(
        "epoch {epoch} of {epochs} of stage '{stage}' was kept ({criterion}), one of the last: it "
        "was still improving",
        "train longer: read the recipe with `changes=` stages.{index}.epochs={longer}",
    ),
    "physics alone": warning(
        "the trained correction makes free runs of the validation records no better than the "
        "physics alone (RMSE {trained:.3g} against {physics:.3g} {unit}): the model is the "
        "physics, with a correction of 0",
        "take the physics, or train longer",
    ),
    "worse after first": warning(
        "epoch {epoch} of {epochs} of stage '{stage}' was kept ({criterion}), one of the first: "
        "what followed was worse",
        "train more carefully: read the recipe with `changes=` stages.*.rate={rate:.1g}",
    ),
}
