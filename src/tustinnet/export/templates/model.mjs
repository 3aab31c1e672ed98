// A model of a mechanical system, stepped from sample to sample.
//
//   import { init, step } from "./model.mjs";
//   const state = init(x0);  // x0: as many numbers as `states` has names
//   step(state, u);          // u: all inputs of the first sample of `samples`, then of the next
//   state.x                  // a Float64Array

// what the numbers of a state are called
export const states = @states@;
// what the inputs are called
export const inputs = @inputs@;
// from one state to the next [s]
export const period = @period@;
// the samples whose inputs a step is given, counted from the one at which it begins
export const samples = @samples@;
// smallest and largest states and inputs of the training records, null where nobody knows
export const range = @range@;

@helpers@
@vectors@

function sized(values, size, name) {
  if (values.length === size) return values;
  throw new RangeError(`${name} has ${values.length} numbers, not ${size}`);
}

// A state, which `step` changes.
export function init(x0) {
  return { x: Float64Array.from(sized(x0, @n_x@, "x0")) };
}

// Takes a state to the next sample, in place, and returns it.
export function step(state, u) {
  v0.set(state.x);
  v1.set(sized(u, @n_w@, "u"));
@body@
  state.x.set(@following@);
  return state;
}
