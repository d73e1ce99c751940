// A camera that circles a point, and the reader's hand on it.

/** Least and most of the angle above the horizon, in radians: short of straight up, where directions have no side. */
const PITCH_MAX = 1.55;
/** Change of distance by a step of a wheel. */
const WHEEL = 0.0015;
/** Steps of arrow keys, in radians. */
const KEY_RAD = 0.08;

export class Orbit {
  constructor({ targetM, distanceM, yawRad, pitchRad, fovYRad, diagonalM }) {
    Object.assign(this, { targetM, distanceM, yawRad, pitchRad, fovYRad, diagonalM });
  }

  /** Around the middle of bounds, from outside. */
  static around(boundsM) {
    const [low, high] = [Array.from(boundsM.slice(0, 3)), Array.from(boundsM.slice(3, 6))];
    const diagonalM = Math.hypot(...high.map((bound, axis) => bound - low[axis]));
    const targetM = low.map((bound, axis) => 0.5 * (bound + high[axis]));
    return new Orbit({ targetM, distanceM: 1.2 * diagonalM, yawRad: 0.6, pitchRad: 0.4, fovYRad: 0.8, diagonalM });
  }

  /** From a camera's place, around the point of its view that is nearest to the middle of bounds. */
  static of({ eyeM, targetM, fovYRad }, boundsM) {
    const { targetM: middle, diagonalM } = Orbit.around(boundsM);
    const look = targetM.length === 3 ? Array.from(targetM, (at, axis) => at - eyeM[axis]) : [0, 0, -1];
    const length = Math.hypot(...look) || 1;
    const ahead = look.map((along) => along / length);
    const toMiddle = ahead.reduce((sum, along, axis) => sum + along * (middle[axis] - eyeM[axis]), 0);
    const distanceM = Math.max(toMiddle, 0.1 * diagonalM);
    return new Orbit({
      targetM: ahead.map((along, axis) => eyeM[axis] + along * distanceM),
      distanceM,
      yawRad: Math.atan2(-ahead[0], -ahead[2]),
      pitchRad: Math.asin(Math.max(-1, Math.min(1, -ahead[1]))),
      fovYRad: fovYRad > 0 ? fovYRad : 0.8,
      diagonalM,
    });
  }

  /** Unit vectors to the right, up, and back towards the eye. */
  axes() {
    const [sinYaw, cosYaw] = [Math.sin(this.yawRad), Math.cos(this.yawRad)];
    const [sinPitch, cosPitch] = [Math.sin(this.pitchRad), Math.cos(this.pitchRad)];
    return {
      right: [cosYaw, 0, -sinYaw],
      up: [-sinYaw * sinPitch, cosPitch, -cosYaw * sinPitch],
      back: [sinYaw * cosPitch, sinPitch, cosYaw * cosPitch],
    };
  }

  /** The camera as frames take it. */
  camera() {
    const { back } = this.axes();
    return {
      name: "orbit",
      eyeM: this.targetM.map((at, axis) => at + back[axis] * this.distanceM),
      targetM: [...this.targetM],
      up: [0, 1, 0],
      fovYRad: this.fovYRad,
      orthographicHalfHeightM: null,
    };
  }

  turn(yawRad, pitchRad) {
    this.yawRad += yawRad;
    this.pitchRad = Math.max(-PITCH_MAX, Math.min(PITCH_MAX, this.pitchRad + pitchRad));
  }

  /** Multiplies the distance, within reason for the scene. */
  near(factor) {
    this.distanceM = Math.max(1e-3 * this.diagonalM, Math.min(10 * this.diagonalM, this.distanceM * factor));
  }

  /**
   * Follows pointers, wheel and arrow keys on an element; gives a function that ends it. `grab` is asked for what lies under a pointer that
   * is put down: a function that moves it along, or null.
   */
  follow(element, { changed, moveLamp, lamp, grab = () => null }) {
    const ended = new AbortController();
    const on = (type, heard) => element.addEventListener(type, heard, { signal: ended.signal, passive: false });
    const pointers = new Map();
    let held = null;
    on("pointerdown", (event) => {
      element.setPointerCapture(event.pointerId);
      pointers.set(event.pointerId, event);
      held = pointers.size === 1 && !isOfLamp(event) ? grab(event) : null;
    });
    for (const type of ["pointerup", "pointercancel"]) {
      on(type, (event) => {
        pointers.delete(event.pointerId);
        held = null;
      });
    }
    on("pointermove", (event) => {
      const before = pointers.get(event.pointerId);
      if (before === undefined) return;
      if (pointers.size === 2) this.#pinch(pointers, before, event);
      else if (held !== null) held(event);
      else if (isOfLamp(event)) moveLamp(this.#alongScreen(element, event, before, lamp()));
      else this.turn((before.clientX - event.clientX) * 0.008, (event.clientY - before.clientY) * 0.008);
      pointers.set(event.pointerId, event);
      changed();
    });
    on("contextmenu", (event) => event.preventDefault());
    on("wheel", (event) => {
      event.preventDefault();
      this.near(Math.exp(event.deltaY * WHEEL));
      changed();
    });
    on("keydown", (event) => {
      const steps = { ArrowLeft: [-1, 0], ArrowRight: [1, 0], ArrowUp: [0, 1], ArrowDown: [0, -1] }[event.key];
      if (steps === undefined) return;
      event.preventDefault();
      this.turn(steps[0] * KEY_RAD, steps[1] * KEY_RAD);
      changed();
    });
    return () => ended.abort();
  }

  /** Brings the camera nearer as two fingers part. */
  #pinch(pointers, before, event) {
    const [other] = [...pointers.values()].filter(({ pointerId }) => pointerId !== event.pointerId);
    const apart = ({ clientX, clientY }) => Math.hypot(clientX - other.clientX, clientY - other.clientY) || 1;
    this.near(apart(before) / apart(event));
  }

  /** How far a point moves in metres, parallel to the picture, to stay below the pointer. */
  #alongScreen(element, event, before, pointM) {
    const { right, up, back } = this.axes();
    const { eyeM } = this.camera();
    const depth = back.reduce((sum, along, axis) => sum + along * (eyeM[axis] - pointM[axis]), 0);
    const metresPerPixel = (2 * Math.max(depth, 0.01 * this.diagonalM) * Math.tan(this.fovYRad / 2)) / element.clientHeight;
    const [dx, dy] = [event.clientX - before.clientX, before.clientY - event.clientY];
    return right.map((along, axis) => (along * dx + up[axis] * dy) * metresPerPixel);
  }
}

/** Whether a pointer is to move the lamp. */
function isOfLamp({ buttons, shiftKey }) {
  return (buttons & 2) !== 0 || shiftKey;
}
