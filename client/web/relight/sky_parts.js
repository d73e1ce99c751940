// Mean radiance of a panorama over the parts of a bake's sky; twin of proto/src/relight/panorama.rs.

import { FINE } from "./panorama_image.js";
import { relightDirection } from "./sky.js";

/**
 * Mean radiance over each of so many parts of the sky, a power of two, four numbers each: over the directions that are nearest to
 * `relightDirection`; each pixel of a reduced picture counts as its middle, by its solid angle, those of coarse ones in several pieces
 * alike. The middle of the picture lies in direction −z, turned by degrees about y towards −x.
 */
export function partMeans(image, turnDeg, parts) {
  const nearest = nearestPart(parts);
  const sums = new Float64Array(4 * parts);
  const [across, down] = [Math.ceil(FINE[0] / image.width), Math.ceil(FINE[1] / image.height)];
  const [columns, rows] = [image.width * across, image.height * down];
  const around = Array.from({ length: columns }, (_, column) => {
    const angle = ((column + 0.5) / columns - 0.5) * 2 * Math.PI - (turnDeg * Math.PI) / 180;
    return [Math.sin(angle), -Math.cos(angle)];
  });
  for (let row = 0; row < rows && parts > 0; row++) {
    const up = (edge) => Math.cos((edge / rows) * Math.PI);
    const solidAngle = ((2 * Math.PI) / columns) * (up(row) - up(row + 1));
    const [level, height] = [Math.sin(((row + 0.5) / rows) * Math.PI), up(row + 0.5)];
    const first = Math.floor(row / down) * image.width;
    for (let column = 0; column < columns; column++) {
      const [x, z] = around[column];
      const sum = 4 * nearest(level * x, height, level * z);
      const pixel = 3 * (first + Math.floor(column / across));
      for (let channel = 0; channel < 3; channel++) sums[sum + channel] += solidAngle * image.pixels[pixel + channel];
      sums[sum + 3] += solidAngle;
    }
  }
  const means = new Float32Array(4 * parts);
  for (let at = 0; at < sums.length; at += 4) {
    const whole = sums[at + 3];
    for (let channel = 0; channel < 3 && whole > 0; channel++) means[at + channel] = sums[at + channel] / whole;
  }
  return means;
}

/** Finds the part of the sky that is nearest to a direction; of equally near ones the first. */
function nearestPart(count) {
  const parts = Array.from({ length: count }, (_, part) => ({ part, direction: relightDirection(part, count) }));
  parts.sort((a, b) => b.direction[2] - a.direction[2] || a.part - b.part);
  const [xs, ys, zs] = [0, 1, 2].map((axis) => Float64Array.from(parts, ({ direction }) => direction[axis]));
  const numbers = Uint32Array.from(parts, ({ part }) => part);
  // Parts are spread evenly: none is farther from a direction than the side of a square of twice its area.
  const reach = Math.sqrt((8 * Math.PI) / count);
  return (x, y, z) => {
    let [at, end] = [0, count];
    while (at < end) {
      const half = (at + end) >>> 1;
      if (zs[half] > z + reach) at = half + 1;
      else end = half;
    }
    let [best, most] = [0, -Infinity];
    for (; at < count && zs[at] >= z - reach; at++) {
      const cosine = x * xs[at] + y * ys[at] + z * zs[at];
      if (cosine > most || (cosine === most && numbers[at] < best)) [best, most] = [numbers[at], cosine];
    }
    return best;
  };
}
