// Controls for a panorama of the reader's own as the sky: a file, its turn and its strength.

import { Panorama } from "../relight/panorama.js";
import { el, fill, notice, slider } from "./dom.js";
import { Turns } from "./turns.js";

/** Longest file that is read, in bytes: above the largest panorama without packing. */
const FILE_MAX = 2 ** 28;
// Kinds of work: which panorama there is, and how it is turned and scaled.
const PICTURE = "picture";
const HOW = "how";

/**
 * A field for a file, controls that come with it, and a place for troubles, as `elements`; and `take`, which takes a file from elsewhere.
 * The panorama goes when `signal` is raised.
 */
export function skyOf(viewer, signal = null) {
  const input = el("input", { type: "file", accept: ".hdr,.pic" });
  const told = el("div", { class: "told", role: "status" });
  let panorama = null;
  let how = { turnDeg: 0, strength: 1 };
  // What a file is refused for stands until there is another picture, whatever sliders do.
  const turns = new Turns((kind, error) => {
    if (error !== null) fill(told, notice(error.message, { isBad: true }));
    else if (kind === PICTURE) fill(told);
  });
  const turn = slider("Turn of the sky", (share) => change({ turnDeg: 360 * (share - 0.5) }));
  const strength = slider("Sky brightness", (share) => change({ strength: share === 0 ? 0 : 2 ** (8 * (share - 0.5)) }));
  const none = el("button", { type: "button" }, "No panorama");
  const more = [turn.label, strength.label, none];
  const show = () => more.forEach((element) => (element.hidden = panorama === null));
  const change = (part) => {
    how = { ...how, ...part };
    turns.run(HOW, () => panorama && viewer.setSky(panorama, how));
  };
  const read = async (file) => {
    if (file.size > FILE_MAX) throw new Error(`panorama ${file.name}: has ${file.size} bytes, more than the ${FILE_MAX} that are read`);
    const made = await Panorama.read(file.name, new Uint8Array(await file.arrayBuffer()));
    try {
      signal?.throwIfAborted();
      await viewer.setSky(made, { turnDeg: 0, strength: 1 });
    } catch (error) {
      made.close();
      throw error;
    }
    panorama?.close();
    if (signal?.aborted) made.close();
    [panorama, how] = [made, { turnDeg: 0, strength: 1 }];
    [turn, strength].forEach(({ set }) => set(0.5));
    show();
  };
  const remove = async () => {
    await viewer.setSky(null);
    panorama?.close();
    panorama = null;
    input.value = "";
    show();
  };
  const take = (file) => turns.run(PICTURE, () => read(file));
  input.addEventListener("change", () => input.files.length > 0 && take(input.files[0]));
  none.addEventListener("click", () => turns.run(PICTURE, remove));
  show();
  // Its Worker has memory of the picture.
  signal?.addEventListener("abort", () => panorama?.close(), { once: true });
  return { elements: [el("label", {}, el("span", {}, "Sky, a panorama (.hdr)"), input), ...more, told], take };
}
