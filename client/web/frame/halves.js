// 16-bit floats, for devices that draw glass over them alone.

/** Numbers of their bits. */
export function halves(bits) {
  return Float32Array.from(bits, (word) => {
    const sign = word >>> 15 === 0 ? 1 : -1;
    const exponent = (word >>> 10) & 31;
    const fraction = word & 1023;
    if (exponent === 31) return fraction === 0 ? sign * Infinity : NaN;
    return sign * (exponent === 0 ? fraction * 2 ** -24 : (1024 + fraction) * 2 ** (exponent - 25));
  });
}
