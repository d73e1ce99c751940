// The reader's hand on a page's controls for skies and objects, and what the picture is then.

import { BundleSource } from "/web/fetch.js";
import { followDrops } from "/web/page/dropped.js";
import { objectsOf } from "/web/page/objects.js";
import { skyOf } from "/web/page/sky.js";
import { Turns } from "/web/page/turns.js";
import { Viewer } from "/web/view.js";

const WAIT_MS = 50;

async function waitFor(what, isThere) {
  for (let turn = 0; !isThere(); turn++) {
    if (turn > 1200) throw new Error(`never: ${what}`);
    await new Promise((resolve) => setTimeout(resolve, WAIT_MS));
  }
}

/** Work that ran, and how it ended: of two of a kind that wait the last, and none is lost by those of another kind. */
export async function turns() {
  const [ran, told] = [[], []];
  const own = new Turns((kind, error) => told.push([kind, error?.message ?? null]));
  const work = (name) => () => void ran.push(name);
  let release = null;
  const all = own.run("how", () => new Promise((resolve) => (release = resolve)));
  own.run("picture", work("first picture"));
  own.run("how", work("first turn"));
  own.run("picture", () => {
    ran.push("second picture");
    throw new Error("no picture");
  });
  own.run("how", work("second turn"));
  release();
  await all;
  await own.run("picture", work("third picture"));
  return { ran, told };
}

async function opened(base) {
  const canvas = document.createElement("canvas");
  canvas.style.cssText = "width: 160px; height: 120px; display: block";
  // A made pointer cannot be captured.
  canvas.setPointerCapture = () => {};
  document.body.append(canvas);
  let isDone = false;
  const viewer = await Viewer.open(canvas, new BundleSource(base), { onProgress: ({ share }) => (isDone = share === 1) });
  await waitFor("all light", () => isDone);
  const [sky, objects] = [skyOf(viewer), objectsOf(viewer)];
  const controls = document.createElement("div");
  controls.append(...sky.elements, ...objects.elements);
  document.body.append(controls);
  followDrops(canvas, { takeObject: objects.take, takeSky: sky.take });
  return { canvas, viewer, controls };
}

/** Drops files, each of a name and bytes, at a place of the picture. */
function drop(canvas, files, [x, y]) {
  const { left, top } = canvas.getBoundingClientRect();
  const dataTransfer = new DataTransfer();
  files.forEach(([name, bytes]) => dataTransfer.items.add(new File([bytes], name)));
  canvas.dispatchEvent(new DragEvent("drop", { dataTransfer, clientX: left + x, clientY: top + y, cancelable: true }));
}

function slide(controls, name, share) {
  const label = [...controls.querySelectorAll("label")].find((element) => element.textContent === name);
  const input = label.querySelector("input");
  input.value = String(share * Number(input.max));
  input.dispatchEvent(new Event("input"));
}

function button(controls, text) {
  return [...controls.querySelectorAll("button")].find((element) => element.textContent === text && !element.hidden);
}

/** E_ind once light has settled. */
async function light(viewer) {
  await waitFor("settled light", () => viewer.frame.settled);
  return viewer.frame.readIndirect();
}

/** Sum of differences over the sum of the first, and the sum of the second over that of the first. */
function compared(a, b) {
  let [sum, apart, other] = [0, 0, 0];
  a.forEach((value, at) => {
    sum += value;
    other += b[at];
    apart += Math.abs(value - b[at]);
  });
  return { apart: apart / sum, ratio: other / sum };
}

/** Skies that are dropped, turned, scaled and taken away: calls of the viewer, and light beside that without a sky. */
export async function sky(base) {
  const { canvas, viewer, controls } = await opened(base);
  const bytes = new Uint8Array(await (await fetch("/sky.hdr")).arrayBuffer());
  const calls = [];
  const { setSky } = viewer;
  viewer.setSky = async (panorama, how) => {
    await setSky.call(viewer, panorama, how);
    calls.push([panorama?.name ?? null, how ?? null]);
  };
  const call = (count) => waitFor(`call ${count}`, () => calls.length >= count);
  const bare = await light(viewer);
  // Two files and a turn before the first file is read: the last file alone counts after it, and no file is lost by the turn.
  drop(canvas, [["one.hdr", bytes], ["two.hdr", bytes], ["three.hdr", bytes]], [80, 60]);
  await waitFor("three.hdr", () => calls.some(([name]) => name === "three.hdr"));
  const names = calls.map(([name]) => name);
  const lit = await light(viewer);
  const found = { names, lit: compared(bare, lit) };
  const slid = async (name, share) => {
    const before = calls.length;
    slide(controls, name, share);
    await call(before + 1);
    return { how: calls.at(-1)[1], ...compared(lit, await light(viewer)) };
  };
  found.turned = await slid("Turn of the sky", 0.75);
  found.back = await slid("Turn of the sky", 0.5);
  found.brighter = await slid("Sky brightness", 0.75);
  found.dark = await slid("Sky brightness", 0);
  found.unlit = compared(bare, await light(viewer));
  // A file that is none is told of, also once a slider has moved, and the sky stays.
  drop(canvas, [["wrong.hdr", new Uint8Array(9)]], [80, 60]);
  await waitFor("words", () => controls.querySelector(".notice.bad") !== null);
  await slid("Sky brightness", 0.5);
  found.told = controls.querySelector(".notice.bad")?.textContent ?? null;
  const before = calls.length;
  button(controls, "No panorama").click();
  await call(before + 1);
  found.gone = [calls.at(-1)[0], controls.querySelector(".notice.bad") === null, compared(bare, await light(viewer))];
  viewer.close();
  return found;
}

function drag(canvas, from, to) {
  const { left, top } = canvas.getBoundingClientRect();
  const event = (type, [x, y]) =>
    new PointerEvent(type, { pointerId: 1, clientX: left + x, clientY: top + y, buttons: 1, bubbles: true });
  canvas.dispatchEvent(event("pointerdown", from));
  canvas.dispatchEvent(event("pointermove", to));
  canvas.dispatchEvent(event("pointerup", to));
}

/** An object that is dropped, dragged, turned, played, and taken away, beside a sky that is dropped with it. */
export async function objects(base, at) {
  const { canvas, viewer, controls } = await opened(base);
  const [glb, hdr] = await Promise.all(
    ["/toy.glb", "/sky.hdr"].map(async (file) => new Uint8Array(await (await fetch(file)).arrayBuffer())),
  );
  const bare = await light(viewer);
  // By its first bytes it is an object, whatever its name.
  drop(canvas, [["toy.bin", glb]], at);
  const set = () => viewer.frame.objects;
  await waitFor("an object", () => set().objects.length === 1);
  const stance = () => set().stances[0];
  const low = () => Math.min(...set().drawsOf(0).flatMap(({ vertices }) => Array.from({ length: vertices.length / 14 }, (_, i) => vertices[14 * i + 1])));
  const found = { stands: { at: [...stance().positionM], low: low() } };
  const eye = [...viewer.frame.camera.eyeM];
  const made = viewer.frame.gpu.created;
  drag(canvas, [at[0], at[1] - 6], [at[0] + 20, at[1] - 6]);
  found.dragged = { at: [...stance().positionM], isEyeSame: viewer.frame.camera.eyeM.every((value, axis) => value === eye[axis]) };
  slide(controls, "Turn", 0.75);
  slide(controls, "Size", 1);
  found.shadow = compared(bare, await light(viewer));
  slide(controls, "Size", 0.75);
  found.turned = [stance().turnDeg[0], stance().scale];
  button(controls, "Play").click();
  await waitFor("its animation", () => stance().timeS > 0.1);
  button(controls, "Pause").click();
  const stopped = stance().timeS;
  await light(viewer);
  found.played = [stopped > 0, stance().timeS === stopped];
  slide(controls, "Time", 0.5);
  found.timeS = stance().timeS;
  found.made = viewer.frame.gpu.created - made;
  drop(canvas, [["no.glb", new Uint8Array([1, 2, 3])], ["clouds.hdr", hdr]], at);
  await waitFor("a sky", () => controls.querySelectorAll("button:not([hidden])").length > 0 && button(controls, "No panorama") !== undefined);
  await waitFor("words", () => controls.querySelector(".notice.bad") !== null);
  found.told = controls.querySelector(".notice.bad").textContent;
  found.kept = set().objects.length;
  button(controls, "No panorama").click();
  await waitFor("no sky", () => button(controls, "No panorama") === undefined);
  button(controls, "Remove").click();
  await waitFor("no object", () => set().objects.length === 0);
  found.gone = compared(bare, await light(viewer));
  found.left = controls.querySelectorAll(".object").length;
  viewer.close();
  return found;
}
