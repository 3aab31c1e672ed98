// the numbers of a text in base64, 64 bits each, the lowest byte first
function decoded(text) {
  const bytes = Uint8Array.from(atob(text), (c) => c.charCodeAt(0));
  const view = new DataView(bytes.buffer);
  return Float64Array.from({ length: bytes.length / 8 }, (_, i) => view.getFloat64(8 * i, true));
}

// a matrix, row by row, times a vector
function product(out, matrix, vector) {
  for (let i = 0, k = 0; i < out.length; i++) {
    let sum = 0;
    for (let j = 0; j < vector.length; j++, k++) sum += matrix[k] * vector[j];
    out[i] = sum;
  }
}

// one of several vectors that stand one after the other
function take(out, from, which) {
  for (let i = 0; i < out.length; i++) out[i] = from[which * out.length + i];
}

// as IEEE 754 has it: powers of 1 are 1, and those of -1 by infinities
function power(x, y) {
  return x === 1 || (x === -1 && Math.abs(y) === Infinity) ? 1 : x ** y;
}
