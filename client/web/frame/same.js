// Comparison of what callers set with what is set.

/** Whether two trees of plain values, lists and typed arrays are the same. */
export function isSame(a, b) {
  const plain = (_, value) => (ArrayBuffer.isView(value) ? Array.from(value) : value);
  return JSON.stringify(a, plain) === JSON.stringify(b, plain);
}
