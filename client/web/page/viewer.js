// The picture of a bake with its controls, or a plain word where there can be none.

import { Unsupported, Viewer } from "../view.js";
import { el, fill, notice } from "./dom.js";

/** Steps of a slider from one end of the scene to the other. */
const STEPS = 200;

/** Shows the bake's picture in `place` until `signal` is raised. */
export async function viewerOf(place, source, signal) {
  const canvas = el("canvas", { tabindex: 0, "aria-label": "Picture of the bake: arrow keys turn the camera" });
  const over = el("p", { class: "over", role: "status" }, "opening …");
  const controls = el("div", { class: "controls" });
  fill(place, el("div", { class: "viewer" }, el("div", { class: "stage" }, canvas, over), controls));
  const onFailure = (error) => signal.aborted || fill(place, told(error));
  const onProgress = ({ words, share }) => {
    over.textContent = words;
    over.hidden = share === 1;
  };
  try {
    const viewer = await Viewer.open(canvas, source, { signal, onProgress, onFailure });
    if (signal.aborted) viewer.close();
    else signal.addEventListener("abort", () => viewer.close(), { once: true });
    fill(controls, controlsOf(viewer));
  } catch (error) {
    onFailure(error);
  }
}

function told(error) {
  const isBad = !(error instanceof Unsupported);
  const rest = isBad ? "" : ": the bake cannot be shown here, 'kiln preview' draws it.";
  return notice(`The picture: ${error.message}${rest}`, { isBad });
}

function controlsOf(viewer) {
  const [low, high] = viewer.frame.boundsM;
  const lampAxis = (axis) => {
    const size = high[axis] - low[axis] || 1;
    const at = (viewer.lamp.positionM[axis] - low[axis]) / size;
    return slider(`Lamp ${"xyz"[axis]}`, at, (share) => {
      viewer.lamp.positionM[axis] = low[axis] + share * size;
      viewer.changed();
    });
  };
  const usual = viewer.exposure;
  return [
    ...[0, 1, 2].map(lampAxis),
    slider("Lamp brightness", 0.5, (share) => {
      viewer.lamp.share = share === 0 ? 0 : 2 ** (8 * (share - 0.5));
      viewer.changed();
    }),
    slider("Exposure", 0.5, (share) => (viewer.exposure = usual * 2 ** (8 * (share - 0.5)))),
    el("p", { class: "quiet small" }, "Drag to turn, wheel to come nearer; Shift or the right button moves the lamp."),
  ];
}

/** A slider from 0 to 1. */
function slider(name, value, changed) {
  const input = el("input", {
    type: "range",
    min: 0,
    max: STEPS,
    value: Math.round(STEPS * Math.max(0, Math.min(1, value))),
    oninput: () => changed(Number(input.value) / STEPS),
  });
  return el("label", {}, el("span", {}, name), input);
}
