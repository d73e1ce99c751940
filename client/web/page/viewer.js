// The picture of a bake with its controls, or a plain word where there can be none.

import { Unsupported, Viewer } from "../view.js";
import { coloursOf } from "./colours.js";
import { detailOf } from "./detail.js";
import { el, fill, notice, slider } from "./dom.js";
import { followDrops } from "./dropped.js";
import { objectsOf } from "./objects.js";
import { picturesOf } from "./pictures.js";
import { skyOf } from "./sky.js";

/**
 * Shows the bake's picture in `place` until `signal` is raised. Where there can be none, it says why, and shows `pictures` that were drawn
 * before, or a promise of them that does not fail; `show(image, file)` gives an image its picture. `following` is of a bake that goes on,
 * see `Viewer.open`. Resolves, once there is a picture or none, to whether it `stands`: nothing has failed since.
 */
export async function viewerOf(place, source, signal, { pictures = [], show = null, following = null } = {}) {
  const canvas = el("canvas", { tabindex: 0, "aria-label": "Picture of the bake: arrow keys turn the camera" });
  const over = el("p", { class: "over", role: "status" }, "opening …");
  const controls = el("div", { class: "controls" });
  fill(place, el("div", { class: "viewer" }, el("div", { class: "stage" }, canvas, over), controls));
  const state = { stands: false };
  const onFailure = async (error) => {
    state.stands = false;
    if (signal.aborted) return;
    fill(place, told(error, false));
    const drawn = await pictures;
    if (!signal.aborted && drawn.length > 0) fill(place, told(error, true), picturesOf(drawn, show));
  };
  const onProgress = ({ words, share }) => {
    over.textContent = words;
    over.hidden = share === 1;
  };
  const onTrouble = ({ message }) => {
    state.stands = false;
    over.textContent = `the picture stays as it is: ${message}`;
    over.hidden = false;
  };
  try {
    state.stands = true;
    const viewer = await Viewer.open(canvas, source, { signal, following, onProgress, onTrouble, onFailure });
    if (signal.aborted) viewer.close();
    else signal.addEventListener("abort", () => viewer.close(), { once: true });
    fill(controls, controlsOf(viewer, canvas, signal));
  } catch (error) {
    onFailure(error);
  }
  return state;
}

function told(error, hasPictures) {
  const isBad = !(error instanceof Unsupported);
  const instead = hasPictures ? "these pictures were drawn before; lights cannot be moved in them." : "'kiln preview' draws it.";
  const rest = isBad ? "" : `: the bake cannot be relit here, ${instead}`;
  return notice(`The picture: ${error.message}${rest}`, { isBad });
}

function controlsOf(viewer, canvas, signal) {
  const [low, high] = viewer.frame.boundsM;
  const sizes = high.map((bound, axis) => bound - low[axis] || 1);
  const places = sizes.map((size, axis) =>
    slider(`Lamp ${"xyz"[axis]}`, (share) => {
      viewer.lamp.positionM[axis] = low[axis] + share * size;
      viewer.changed();
    }),
  );
  // Sliders follow the hand on the picture.
  viewer.onLampMoved = () =>
    places.forEach(({ set }, axis) => set((viewer.lamp.positionM[axis] - low[axis]) / sizes[axis]));
  viewer.onLampMoved();
  const brightness = slider("Lamp brightness", (share) => {
    viewer.lamp.share = share === 0 ? 0 : 2 ** (8 * (share - 0.5));
    viewer.changed();
  });
  const exposure = slider("Exposure", (share) => (viewer.exposure = viewer.usualExposure * 2 ** (8 * (share - 0.5))));
  [brightness, exposure].forEach(({ set }) => set(0.5));
  const [sky, objects] = [skyOf(viewer, signal), objectsOf(viewer)];
  followDrops(canvas, { takeObject: objects.take, takeSky: sky.take });
  return [
    ...[...places, brightness, exposure].map(({ label }) => label),
    ...detailOf(viewer),
    ...sky.elements,
    ...objects.elements,
    coloursOf(viewer),
    el("p", { class: "quiet small hint" }, "Drag to turn, wheel to come nearer; Shift or the right button moves the lamp. Drop a panorama (.hdr) on the picture for a sky, or an object (.glb), which a drag then moves over the floor."),
  ];
}
