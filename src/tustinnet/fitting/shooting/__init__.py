"""Identification of a system's parameters by the simulation error (multiple shooting).

From records to the result, module by module:

1. `identify` reads the recipe; `sensor_errors`, `added_forces` and `groups` add the parameters that
   it names.
2. `checks` refuses systems and records that cannot be simulated; `problem` has all that is fixed.
3. `space` says which parameters are free, and turns their values into a vector within bounds.
4. `optional_terms`, with `leave_out`, drops terms that the records do not need.
5. `holds` runs the search, for every hold of an input that is unknown. `stages` is the search:
   `identifiability` fixes confounded parameters, `equation_error` gives first values,
   `horizons` says over how long records can be simulated; then come stages over longer and longer
   `segments`.
6. In a stage `least_squares`, by `levenberg_marquardt`, minimises the error that `normal`
   simulates with the `equations` of motion.
7. `refit` fits the parameters once more to free runs, where the recipe asks for it.
8. `results` makes estimates and errors (`uncertainty`, `agreement`) and `findings` sentences.

Beside it, `information` computes how well records would determine parameters.
"""
