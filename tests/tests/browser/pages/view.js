// Opens a bake on a canvas as the farm's face does, and measures its picture.

import { BundleSource } from "/web/fetch.js";
import { Viewer } from "/web/view.js";

const WAIT_MS = 50;

function waitFor(isThere) {
  return new Promise((resolve) => {
    const look = () => (isThere() ? resolve() : setTimeout(look, WAIT_MS));
    look();
  });
}

/** Mean radiance of the picture that stands when light has settled. */
async function mean(viewer) {
  await waitFor(() => viewer.frame.settled);
  viewer.frame.draw(viewer.context);
  const radiance = await viewer.frame.readRadiance();
  return radiance.reduce((sum, value, at) => (at % 4 === 3 ? sum : sum + value), 0) / radiance.length;
}

function drag(canvas, from, to, more) {
  const place = canvas.getBoundingClientRect();
  const event = (type, [x, y]) =>
    new PointerEvent(type, { pointerId: 1, clientX: place.x + x, clientY: place.y + y, buttons: 1, bubbles: true, ...more });
  // A made pointer cannot be captured.
  canvas.setPointerCapture = () => {};
  canvas.dispatchEvent(event("pointerdown", from));
  canvas.dispatchEvent(event("pointermove", to));
  canvas.dispatchEvent(event("pointerup", to));
}

/** Words of progress, clusters, and means of the picture: as opened, with all light, with the lamp off, and turned away. */
export async function view(base) {
  const canvas = document.createElement("canvas");
  canvas.style.cssText = "width: 160px; height: 120px; display: block";
  document.body.append(canvas);
  const [words, failures] = [[], []];
  const viewer = await Viewer.open(canvas, new BundleSource(base), {
    onProgress: (told) => words.push(told.words),
    onTrouble: (error) => failures.push(String(error.stack ?? error)),
    onFailure: (error) => failures.push(String(error.stack ?? error)),
  });
  const first = viewer.clusters;
  await waitFor(() => words.includes("all light is here") || failures.length > 0);
  const whole = await mean(viewer);
  const before = [...viewer.lamp.positionM];
  drag(canvas, [80, 60], [100, 40], { shiftKey: true });
  const moved = viewer.lamp.positionM.map((at, axis) => at - before[axis]);
  viewer.lamp.share = 0;
  viewer.changed();
  const off = await mean(viewer);
  const { eyeM } = viewer.orbit.camera();
  drag(canvas, [80, 60], [140, 60], {});
  const turned = viewer.orbit.camera().eyeM.map((at, axis) => at - eyeM[axis]);
  const size = [canvas.width, canvas.height];
  viewer.close();
  return { first, clusters: viewer.clusters, whole, off, moved, turned, size, failures };
}
