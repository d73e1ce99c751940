// The geometry of rectangular lights; twin of proto/src/rectangle.rs.

import { cross, normalised, times } from "./maths.js";

/** Most points of a rectangular light that its shadows are cast from, and those unless it says otherwise. */
export const RECT_POINTS_MAX = 16;
export const RECT_POINTS = 4;
// Length of a vector across the light, of a unit hint, below which rounding alone would turn the rectangle.
const ACROSS_MIN = 1e-4;
// Share by which sides of cells have to be more alike, so that rounding decides no tie.
const TIE = 1e-4;

/** Centre, half sides in metres and direction of a light of kind `rect`; null for one without direction or area. */
export function rectangleOf({ positionM, direction: given, up: hint, sizeM }) {
  const direction = normalised(Array.from(given));
  if (direction === null) {
    return null;
  }
  // A hint along the light is as good as none.
  const rights = [Array.from(hint), defaultUp(direction)].map((up) => {
    const unit = normalised(up);
    const across = unit && cross(direction, unit);
    return across && Math.hypot(...across) >= ACROSS_MIN ? normalised(across) : null;
  });
  const right = rights.find((vector) => vector !== null);
  const [width, height] = sizeM;
  if (right === undefined || !(width > 0 && height > 0 && Number.isFinite(width) && Number.isFinite(height))) {
    return null;
  }
  const [halfU, halfV] = [times(right, width / 2), times(cross(right, direction), height / 2)];
  return { centreM: Array.from(positionM), halfU, halfV, direction };
}

/** Columns and rows of so many cells alike, as near to squares as may be; of ties fewer columns. */
export function cellsOf([width, height], points) {
  const count = Math.min(Math.max(points, 1), RECT_POINTS_MAX);
  const longer = (columns) => {
    const ratio = ((width / height) * (count / columns)) / columns;
    return Math.max(ratio, 1 / ratio);
  };
  let best = 1;
  for (let columns = 2; columns <= count; columns++) {
    if (count % columns === 0 && longer(columns) < longer(best) * (1 - TIE)) {
      best = columns;
    }
  }
  return [best, count / best];
}

/** Direction of the height of a rectangle that shines along `direction`, unless given. */
export function defaultUp(direction) {
  return Math.abs(direction[1]) > 0.9 ? [0, 0, -1] : [0, 1, 0];
}
