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
  // What is told of each piece of work, until the reader brings more after all of it has ended.
  const notes = new Map();
  let waiting = 0;
  const tell = (kind, words) => {
    notes.set(kind, words);
    fill(told, [...notes.values()].flat());
  };
  const turns = new Turns((kind, error) => {
    waiting -= 1;
    if (error !== null) tell(kind, [notice(error.message, { isBad: true })]);
  });
  const run = (kind, work) => {
    if (waiting === 0) notes.clear();
    waiting += 1;
    return turns.run(kind, work);
  };
  const apply = async (wanted) => {
    await viewer.setObjects(wanted.map(({ object }) => object), wanted.map(({ stance }) => stance));
    items = wanted;
    fill(list, items.map(({ controls }) => controls));
  };
  const move = (item, part) => {
    // A stance that the file refuses is not kept.
    viewer.moveObject(item.object, { ...item.stance, ...part });
    Object.assign(item.stance, part);
  };
  const remove = (item) => run(Symbol(item.object.name), () => apply(items.filter((other) => other !== item)));
  const read = async (file, place, kind) => {
    if (file.size > FILE_MAX) throw new Error(`object ${file.name}: has ${file.size} bytes, more than the ${FILE_MAX} that are read`);
    const object = SceneObject.fromGlb(file.name, new Uint8Array(await file.arrayBuffer()));
    const item = { object, stance: { positionM: viewer.standAt(object, place), turnDeg: [0, 0, 0], scale: 1, clip: 0, timeS: 0 } };
    Object.assign(item, controlsOf(item, move, remove));
    await apply([...items, item]);
    tell(kind, object.warnings.map((warning) => notice(`${file.name}: ${warning}`)));
  };
  // Each file is work of its own kind: none takes the place of another.
  const take = (file, place = null) => {
    const kind = Symbol(file.name);
    return run(kind, () => read(file, place, kind));
  };
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
  const trouble = el("span", { class: "trouble", role: "status" });
  // A file may be at fault at some time of its animations alone.
  const steer = (part) => {
    try {
      move(item, part);
      trouble.textContent = "";
      return true;
    } catch (error) {
      trouble.textContent = error.message;
      return false;
    }
  };
  const turn = slider("Turn", (share) => steer({ turnDeg: [360 * (share - 0.5), 0, 0] }));
  const size = slider("Size", (share) => steer({ scale: SCALE_MAX ** (2 * share - 1) }));
  [turn, size].forEach(({ set }) => set(0.5));
  const gone = el("button", { type: "button", onclick: () => remove(item) }, "Remove");
  const name = el("span", { class: "name" }, object.name);
  const lengthS = () => object.lengthsS[stance.clip] ?? 0;
  const time = slider("Time", (share) => steer({ timeS: share * lengthS() }));
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
    steer({ clip: Number(choice.value), timeS: 0 });
    time.set(0);
  });
  const tick = (secs) => {
    if (!isPlaying || !(lengthS() > 0)) return;
    const timeS = (stance.timeS + secs) % lengthS();
    time.set(timeS / lengthS());
    if (!steer({ timeS })) setPlaying(false);
  };
  const moving = object.lengthsS.some((length) => length > 0);
  const animation = moving ? [play, time.label, object.lengthsS.length > 1 ? el("label", {}, el("span", {}, "Animation"), choice) : null] : [];
  return { controls: el("div", { class: "object" }, name, turn.label, size.label, ...animation, gone, trouble), tick };
}
