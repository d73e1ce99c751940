// Controls for objects of the reader's own beside a bake: files, the hand that drags them over the floor, and their animations.

import { SceneObject } from "../object/object.js";
import { el, fill, notice, slider } from "./dom.js";
import { Turns } from "./turns.js";

/** Longest file that is read, in bytes. */
const FILE_MAX = 2 ** 28;
// Factor on an object's size from the middle of the slider to either end.
const SCALE_MAX = 8;

/**
 * A field for files, controls of each object, and a place for troubles, as `elements`; and `take`, which takes a file from elsewhere and
 * stands it where the picture has a place, `{clientX, clientY}`.
 */
export function objectsOf(viewer) {
  const input = el("input", { type: "file", accept: ".glb,.gltf", multiple: true });
  const told = el("div", { class: "told", role: "status" });
  const list = el("div", { class: "objects" });
  // Objects that stand there: `{object, stance, controls, tick}`.
  let items = [];
  const turns = new Turns((_, error) => {
    if (error !== null) fill(told, notice(error.message, { isBad: true }));
  });
  const apply = async (wanted) => {
    await viewer.setObjects(wanted.map(({ object }) => object), wanted.map(({ stance }) => stance));
    items = wanted;
    fill(list, items.map(({ controls }) => controls));
  };
  const move = (item, part) => {
    Object.assign(item.stance, part);
    viewer.moveObject(item.object, { ...item.stance });
  };
  const remove = (item) => turns.run(item, () => apply(items.filter((other) => other !== item)));
  const read = async (file, place) => {
    if (file.size > FILE_MAX) throw new Error(`object ${file.name}: has ${file.size} bytes, more than the ${FILE_MAX} that are read`);
    const object = SceneObject.fromGlb(file.name, new Uint8Array(await file.arrayBuffer()));
    const item = { object, stance: { positionM: viewer.standAt(object, place), turnDeg: [0, 0, 0], scale: 1, clip: 0, timeS: 0 } };
    Object.assign(item, controlsOf(item, move, remove));
    await apply([...items, item]);
    fill(told, object.warnings.map((warning) => notice(`${file.name}: ${warning}`)));
  };
  // Each file is work of its own kind: none takes the place of another.
  const take = (file, place = null) => turns.run(Symbol(file.name), () => read(file, place));
  input.addEventListener("change", () => {
    for (const file of input.files) take(file);
    input.value = "";
  });
  viewer.onObjectDragged = (object, positionM) => {
    const item = items.find((own) => own.object === object);
    if (item !== undefined) item.stance.positionM = positionM;
  };
  viewer.onFrame = (secs) => items.forEach((item) => item.tick(secs));
  const label = el("label", {}, el("span", {}, "Objects beside the bake (.glb)"), input);
  return { elements: [label, list, told], take };
}

/** Turn, size and animation of an object, and its leave; `tick` moves it along its animation by seconds while it plays. */
function controlsOf(item, move, remove) {
  const { object, stance } = item;
  const turn = slider("Turn", (share) => move(item, { turnDeg: [360 * (share - 0.5), 0, 0] }));
  const size = slider("Size", (share) => move(item, { scale: SCALE_MAX ** (2 * share - 1) }));
  [turn, size].forEach(({ set }) => set(0.5));
  const gone = el("button", { type: "button", onclick: () => remove(item) }, "Remove");
  const name = el("span", { class: "name" }, object.name);
  const lengthS = () => object.lengthsS[stance.clip] ?? 0;
  const time = slider("Time", (share) => move(item, { timeS: share * lengthS() }));
  time.set(0);
  let isPlaying = false;
  const play = el("button", { type: "button", "aria-pressed": "false" }, "Play");
  const setPlaying = (playing) => {
    isPlaying = playing;
    play.textContent = playing ? "Pause" : "Play";
    play.setAttribute("aria-pressed", String(playing));
  };
  play.addEventListener("click", () => setPlaying(!isPlaying));
  const choice = el("select", {}, object.lengthsS.map((_, clip) => el("option", { value: clip }, `Animation ${clip + 1}`)));
  choice.addEventListener("change", () => {
    move(item, { clip: Number(choice.value), timeS: 0 });
    time.set(0);
  });
  const tick = (secs) => {
    if (!isPlaying || !(lengthS() > 0)) return;
    const timeS = (stance.timeS + secs) % lengthS();
    time.set(timeS / lengthS());
    try {
      move(item, { timeS });
    } catch (error) {
      // A file may be at fault at some time alone: it stops there.
      setPlaying(false);
      name.textContent = error.message;
    }
  };
  const moving = object.lengthsS.some((length) => length > 0);
  const animation = moving ? [play, time.label, object.lengthsS.length > 1 ? el("label", {}, el("span", {}, "Animation"), choice) : null] : [];
  return { controls: el("div", { class: "object" }, name, turn.label, size.label, ...animation, gone), tick };
}
