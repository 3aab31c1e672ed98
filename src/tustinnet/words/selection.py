"""Sentences on how good models are, on the choice among them, and on what is left out."""

from tustinnet.words.sentence import note, warning

_DIFFERENCE = "by {difference:.2g} [[± {error:.2g} ]]{unit} on {records:record}"

SELECTION = {
    # --- how good ---
    "follows to the end": note(
        "follows {records:whole record} to the end without a restart: no coordinate's RMS error "
        "is {limit:percent} of its standard deviation in the record, and more than noise"
    ),
    "follows for": note(
        "follows whole records without a restart: {to_the_end} of {records} to the end, the others "
        "for {seconds:.2g} s in the median, until a coordinate's RMS error so far is "
        "{limit:percent} of its standard deviation in the record, and more than noise"
    ),
    "chosen": note("chosen: {name}, {made}"),
    "records diverge": warning("free runs of some records diverge", "set `horizon` in the plan"),
    "accuracy": note(
        "free runs [[over {horizon:.3g} s ]]of {records:record}[[ (of {total})]] that its models "
        "were not fitted to: {mean:.3g}[[ ± {error:.2g}]] "
        "{unit}, {share:percent} of the error of "
        "{reference} ({reference_error:.3g} {unit}); worst {worst}, {largest:.3g} {unit}"
        "[[{few}, few of them: other records may be much further off]]"
    ),
    "errors by unit": note(
        "of whole records by unit: {errors:.3g} ({reference}: {reference_errors:.3g})"
    ),
    "forces unexplained": note(
        "forces along these records that it does not explain: {shares:percent}"
    ),
    "expected": note(
        "a new record of these kinds: typically {typical:.2g} {unit}, {low:.2g} to {high:.2g} "
        "{unit} in {tenths:.0f} of 10 cases"
    ),
    "expected vaguely": warning(
        "the errors of {count:record}, {least:.2g} to {most:.2g} {unit}, do not tell that of a "
        "new one"
    ),
    "few records make the mean": note(
        "the mean is pessimistic for most records, as few of them make it: {records}",
        "see what is special there[[; typical of a kind: {kinds:.2g} {unit}]]",
    ),
    "pieces are alike": warning(
        "optimistic: pieces of one record are alike, and a new record may be several times as far "
        "off",
        "record more of them",
    ),
    "nothing follows": warning(
        "nothing follows these records [[over {horizon:.3g} s ]]better than {reference}",
        "{remedies:or}",
    ),
    "nothing follows closely": warning(
        "no candidate follows these records closely", "{remedies:or}"
    ),
    # --- the choice ---
    "compared with nothing": note("no other candidate that follows a record was scored"),
    "clearly better": note("clearly better than the next, {other}: " + _DIFFERENCE),
    "not clearly better": note("not clearly better than the next, {other}: " + _DIFFERENCE),
    "not clearly better few": note(
        f"better than the next, {{other}}: {_DIFFERENCE}, too few to be sure"
    ),
    "next as good": note("the next, {other}, is as good on {records:record}, to a fiftieth"),
    "other better": note(f"{{other}} is better {_DIFFERENCE}, not clearly"),
    "other better few": note(f"{{other}} is better {_DIFFERENCE}, too few to choose it by"),
    "simplest": note(
        "simplest that is as good: {name}, {made} ({difference:+.2g}[[ ± {error:.2g}]] {unit}): "
        "{file}"
    ),
    "trainings stopped": warning(
        "trainings stopped by the budget: {stopped} of {total}, whose best weights so far were "
        "taken",
        "`resume=` goes on, more time (`budget=`) avoids it",
    ),
    "identifications stopped": warning(
        "identifications stopped by the budget: {stopped} of {total}, whose last finished stage "
        "was taken",
        "`resume=` repeats it, more time (`budget=`) avoids it",
    ),
    "bands": note(
        "its free runs have bands (simulate `band=`) of up to {level} %, calibrated on the "
        "{records:record} that folds left out"
    ),
    "without score": note("without a score: {candidates} ({why})"),
    # --- what was done before and meanwhile ---
    "short records": note("left out, of fewer than {fewest} samples: {records}"),
    "cut into pieces": warning(
        "{records:record}, cut into {pieces} pieces in time: each is scored by models that did "
        "not see it, but pieces of one record are alike, so that the scores are optimistic"
    ),
    "records shorter than horizon": note(
        "no record is longer than the plan's horizon of {horizon:g} s: judged over whole records"
    ),
    "judged in loop": note(
        "judged by free runs in the loop of the controller in the data card: set points go in, "
        "motion comes out"
    ),
    "whole records decide": note(
        "pieces of records do not tell {candidates:and} apart: the one whose free runs of "
        "whole records are off least is chosen"
    ),
    "judged by pieces": warning(
        "free runs of whole records are further off than 0.3 of the motion: judged over pieces of "
        "{horizon:.3g} s instead, each from a start of its own (`horizon` in a plan)",
        "[[{may_be_controlled}of a machine that a controller held, [controller] in the data card "
        "lets whole records be judged in its loop]]",
    ),
    "candidates left out": note("left out, {why}: {candidates}"),
    "interrupted": warning("interrupted: the best so far was taken", "`resume=` goes on"),
    "ends with best": note(
        "interrupted: ends with the best so far, {candidate}; once more: at once"
    ),
    "processors shared": note(
        "other programs used {share:percent} of the processors: `budget=` {longer:.0f}s does here "
        "what {budget:.0f} s do without them"
    ),
    "no bands": note("no bands around free runs ({why})"),
}
