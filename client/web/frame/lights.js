// Lights of a view, and the light that each sends; twin of client/src/lights.

import { clamped } from "../relight/numbers.js";
import { normalised } from "./maths.js";
import { RECT_POINTS_MAX, cellsOf, rectangleOf } from "./rectangle.js";

/** Shapes of a caster; the numbers are the shaders'. */
export const POINT = 0;
export const SPOT = 1;
export const SUN = 2;
export const RECT = 3;

/** The casters of shadows among lights, in order; those without strength are left out. */
export function castersOf(lights) {
  const casters = lights.map(casterOf).filter((caster) => caster !== null);
  return casters.filter(({ strength }) => Math.max(...strength) > 0);
}

function casterOf({ kind, strength: given }) {
  const down = [0, -1, 0];
  const strength = Array.from(given);
  const blank = {
    position: [0, 0, 0],
    direction: down,
    strength,
    range: 0,
    cone: [-1, -2],
    halfU: [0, 0, 0],
    halfV: [0, 0, 0],
    cells: [0, 0],
    shape: POINT,
  };
  switch (kind.type) {
    case "point":
      return { ...blank, position: Array.from(kind.positionM), range: kind.rangeM ?? 0 };
    case "spot": {
      const outer = clamped(kind.outerRad, 1e-3, Math.PI / 2);
      const inner = clamped(kind.innerRad, 0, outer - 5e-4);
      return {
        ...blank,
        position: Array.from(kind.positionM),
        direction: normalised(Array.from(kind.direction)) ?? down,
        range: kind.rangeM ?? 0,
        cone: [Math.cos(inner), Math.cos(outer)],
        shape: SPOT,
      };
    }
    case "sun":
      return { ...blank, direction: normalised(Array.from(kind.direction)) ?? down, shape: SUN };
    case "rect": {
      const rectangle = rectangleOf(kind);
      return (
        rectangle && {
          ...blank,
          position: rectangle.centreM,
          direction: rectangle.direction,
          halfU: rectangle.halfU,
          halfV: rectangle.halfV,
          cells: cellsOf(kind.sizeM, kind.points),
          shape: RECT,
        }
      );
    }
    default:
      return null;
  }
}

/** Errs where a light has a number that none can have. */
export function checkLights(lights) {
  const isStrength = (values) => Array.from(values).every((value) => Number.isFinite(value) && value >= 0);
  for (const { name, kind, strength } of lights) {
    const isPlace = kind.positionM === undefined || kind.positionM.every(Number.isFinite);
    const isColour = kind.type !== "sky" || (isStrength(kind.zenith) && isStrength(kind.horizon));
    if (!isPlace || !isColour || !isStrength(strength) || (kind.type === "rect" && !isRectangle(kind))) {
      throw new Error(
        `light '${name}' has a number that is negative or not finite, or a rectangle without direction, area or 1 to 16 points`,
      );
    }
  }
}

function isRectangle(kind) {
  const isCount = Number.isInteger(kind.points) && kind.points >= 1 && kind.points <= RECT_POINTS_MAX;
  return isCount && rectangleOf(kind) !== null;
}

/** Errs where a factor on emitters is none that they can have. */
export function checkScale(scale) {
  const bad = scale.find((value) => !(Number.isFinite(value) && value >= 0));
  if (bad !== undefined) {
    throw new Error(`scale ${bad} of emitters is negative or not finite`);
  }
}

/** The first camera of a bake's file, else the one that was chosen when it was baked; null where there is neither. */
export function cameraOf({ cameras, framing }) {
  return cameras[0] ?? framing.camera?.value ?? null;
}

/** The lights of a bake's file, else the one that was chosen when it was baked. */
export function lightsOf({ lights, framing }) {
  return lights.length === 0 && framing.light ? [framing.light.value] : lights;
}
