// The sky as bakes are lit by it; twin of proto/src/relight/sky.rs.

import { clamped } from "./numbers.js";

/** Sum of the skies among `lights`: radiance straight up, and at and below the horizon. Black when there is none. */
export function skyOf(lights) {
  const sum = { zenith: [0, 0, 0], horizon: [0, 0, 0] };
  for (const { kind, strength } of lights) {
    if (kind.type === "sky") {
      for (let channel = 0; channel < 3; channel++) {
        sum.zenith[channel] += kind.zenith[channel] * strength[channel];
        sum.horizon[channel] += kind.horizon[channel] * strength[channel];
      }
    }
  }
  return sum;
}

export function isBlack({ zenith, horizon }) {
  return zenith.concat(horizon).every((value) => value === 0);
}

/** Radiance that arrives from a unit direction, W·m⁻²·sr⁻¹, y up. */
export function skyRadiance({ zenith, horizon }, towardsSky) {
  const share = clamped(towardsSky[1], 0, 1);
  return horizon.map((low, channel) => low + (zenith[channel] - low) * share);
}

// Fraction of a turn by which directions follow each other.
const TURN = 0.6180339887498949;

/** Direction of part `ray` of `rays`, a power of two: an evenly spread spiral, its places in bit-reversed order. */
export function relightDirection(ray, rays) {
  const bits = Math.log2(rays);
  let index = 0;
  for (let bit = 0; bit < bits; bit++) {
    index = index * 2 + ((ray >>> bit) & 1);
  }
  const z = 1 - (2 * index + 1) / rays;
  const radius = Math.sqrt(Math.max(1 - z * z, 0));
  const turn = index * TURN;
  const angle = (turn - Math.floor(turn)) * 2 * Math.PI;
  return [radius * Math.cos(angle), radius * Math.sin(angle), z];
}
