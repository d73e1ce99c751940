// Opens a bake on a canvas as the farm's face does, and measures its picture.

import { BundleSource } from "/web/fetch.js";
import { coloursOf } from "/web/page/colours.js";
import { detailOf } from "/web/page/detail.js";
import { Viewer } from "/web/view.js";

const WAIT_MS = 50;

function waitFor(isThere) {
  return new Promise((resolve) => {
    const look = () => (isThere() ? resolve() : setTimeout(look, WAIT_MS));
    look();
  });
}

/** Mean radiance of the picture that stands when light has settled, of the pixels' middles: edges of a bright panel move with a jitter. */
async function mean(viewer) {
  await waitFor(() => viewer.frame.settled);
  viewer.frame.draw(viewer.context, [0, 0]);
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

/** Means of the picture with black for the first material's colour, by the page's control, and as baked again; and names of materials. */
async function repainted(viewer) {
  const controls = coloursOf(viewer);
  const input = controls.querySelector("input");
  input.value = "#000000";
  input.dispatchEvent(new Event("input"));
  const black = await mean(viewer);
  controls.querySelector("button").click();
  return { black, again: await mean(viewer), names: [...controls.querySelectorAll("span")].map((name) => name.textContent) };
}

/** What the control of detail says of coarse levels, of words that are none, and of all detail; and means of the picture then. */
async function detailed(viewer) {
  const [choice, field, told] = detailOf(viewer);
  const [select, input] = [choice.querySelector("select"), field.querySelector("input")];
  const set = async (element, value) => {
    element.value = value;
    element.dispatchEvent(new Event("change"));
    const before = told.textContent;
    await waitFor(() => told.textContent !== before);
    return told.textContent;
  };
  const coarse = await set(select, "coarse");
  const inDetail = await mean(viewer);
  const wrong = await set(input, "rough");
  const kept = viewer.frame.lodCounts !== null;
  const all = await set(select, "all");
  return { coarse, inDetail, wrong, kept, all, again: await mean(viewer), counts: viewer.frame.lodCounts };
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
  const painted = await repainted(viewer);
  const detail = await detailed(viewer);
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
  return { first, clusters: viewer.clusters, whole, painted, detail, off, moved, turned, size, failures };
}

/**
 * Means of the picture with all light, without any, in a window without size and in its own again, and for how many of its own pixels; and
 * the words of the end when the device goes.
 */
export async function odd(base) {
  const canvas = document.createElement("canvas");
  canvas.style.cssText = "width: 160px; height: 120px; display: block";
  document.body.append(canvas);
  const [words, failures] = [[], []];
  const viewer = await Viewer.open(canvas, new BundleSource(base), {
    onProgress: (told) => words.push(told.words),
    onTrouble: (error) => failures.push(String(error.stack ?? error)),
    onFailure: (error) => failures.push(error.message),
  });
  await waitFor(() => words.includes("all light is here") || failures.length > 0);
  const whole = await mean(viewer);
  const { lights, lamp } = viewer;
  const emitters = viewer.scene.manifest.emitters;
  const shine = (share) => {
    lamp.share = share;
    viewer.lights = lights.map((light) => ({ ...light, strength: light.strength.map((channel) => share * channel) }));
    viewer.frame.setEmitters(emitters.map(() => share));
    viewer.changed();
  };
  shine(0);
  const dark = await mean(viewer);
  shine(1);
  const sized = async (width, height) => {
    const before = viewer.frame.size;
    [canvas.style.width, canvas.style.height] = [`${width}px`, `${height}px`];
    await new Promise((resolve) => new ResizeObserver(resolve).observe(canvas));
    for (let frames = 0; frames < 3; frames++) await new Promise(requestAnimationFrame);
    return { before, size: viewer.frame.size, mean: await mean(viewer) };
  };
  const none = await sized(0, 0);
  const line = await sized(160, 0);
  const again = await sized(160, 120);
  const early = [...failures];
  viewer.device.destroy();
  await waitFor(() => failures.length > early.length);
  return { whole, dark, none, line, again, early, end: failures.at(-1) };
}

/** Ends the device while a bake's manifest is on its way: the error of the opening, its words of progress, and Workers that live on. */
export async function lost(base) {
  let device = null;
  const { requestDevice } = GPUAdapter.prototype;
  GPUAdapter.prototype.requestDevice = async function (...args) {
    return (device = await requestDevice.apply(this, args));
  };
  let workers = 0;
  window.Worker = class extends Worker {
    constructor(...args) {
      super(...args);
      workers++;
    }

    terminate() {
      if (!this.isEnded) workers--;
      this.isEnded = true;
      super.terminate();
    }
  };
  const source = new BundleSource(base);
  const manifest = source.manifest.bind(source);
  source.manifest = async (signal) => {
    device.destroy();
    await device.lost;
    return manifest(signal);
  };
  const words = [];
  const opened = Viewer.open(document.createElement("canvas"), source, { onProgress: (told) => words.push(told.words) });
  const message = await opened.then(() => "opened", (error) => error.message);
  return { message, words, workers };
}
