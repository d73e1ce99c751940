// Controls for a panorama of the reader's own as the sky: a file, its turn and its strength.

import { Panorama } from "../relight/panorama.js";
import { el, fill, notice, slider } from "./dom.js";

/** Longest file that is read, in bytes: above the largest panorama without packing. */
const FILE_MAX = 2 ** 28;

/** A field for a file, controls that come with it, and a place for troubles. Files may be dropped on the picture, too. */
export function skyOf(viewer, picture) {
  const input = el("input", { type: "file", accept: ".hdr,.pic" });
  const told = el("div", { class: "told", role: "status" });
  let panorama = null;
  let how = { turnDeg: 0, strength: 1 };
  // Calls one after the other; of those that wait the last alone counts.
  let wanted = null;
  let isBusy = false;
  const run = async (work) => {
    wanted = work;
    if (isBusy) return;
    isBusy = true;
    while (wanted !== null) {
      const next = wanted;
      wanted = null;
      try {
        await next();
        fill(told);
      } catch (error) {
        fill(told, notice(error.message, { isBad: true }));
      }
    }
    isBusy = false;
  };
  const turn = slider("Turn of the sky", (share) => change({ turnDeg: 360 * (share - 0.5) }));
  const strength = slider("Sky brightness", (share) => change({ strength: share === 0 ? 0 : 2 ** (8 * (share - 0.5)) }));
  const none = el("button", { type: "button" }, "No panorama");
  const more = [turn.label, strength.label, none];
  const show = () => more.forEach((element) => (element.hidden = panorama === null));
  const apply = () => viewer.setSky(panorama, how);
  const change = (part) => {
    how = { ...how, ...part };
    run(apply);
  };
  const take = async (file) => {
    if (file.size > FILE_MAX) throw new Error(`panorama ${file.name}: has ${file.size} bytes, more than the ${FILE_MAX} that are read`);
    const made = await Panorama.read(file.name, new Uint8Array(await file.arrayBuffer()));
    try {
      await viewer.setSky(made, { turnDeg: 0, strength: 1 });
    } catch (error) {
      made.close();
      throw error;
    }
    panorama?.close();
    [panorama, how] = [made, { turnDeg: 0, strength: 1 }];
    [turn, strength].forEach(({ set }) => set(0.5));
    show();
  };
  const chosen = (files) => files.length > 0 && run(() => take(files[0]));
  input.addEventListener("change", () => chosen(input.files));
  picture.addEventListener("dragover", (event) => event.preventDefault());
  picture.addEventListener("drop", (event) => {
    event.preventDefault();
    chosen(event.dataTransfer?.files ?? []);
  });
  none.addEventListener("click", () =>
    run(async () => {
      await viewer.setSky(null);
      panorama?.close();
      panorama = null;
      input.value = "";
      show();
    }),
  );
  show();
  return [el("label", {}, el("span", {}, "Sky, a panorama (.hdr)"), input), ...more, told];
}
