// An evaluation: a bake held against the path tracer, from figures and pictures of `kiln evaluate --out`. It is all shown by this page's
// own elements, as text and pictures.

import { el, fill, notice, table } from "./dom.js";
import { picturesOf } from "./pictures.js";
import { shown } from "./report.js";

const COLUMNS = [["Light"], ["Error", true], ["95 %", true], ["Energy", true], ["95 %", true], ["p95", true], ["p99", true]];
/** Rows of a light that the table has. */
const LIGHTS_MAX = 256;

/** Shows the evaluation that has those files, until `signal` is raised. */
export async function evaluationOf(place, files, signal) {
  try {
    const [figures, gallery] = await Promise.all(["evaluation.json", "pictures.json"].map((name) => files.json(name, signal)));
    const show = (image, file) => files.show(image, `pictures/${file}`);
    if (!signal.aborted) fill(place, el("h2", {}, "Evaluation"), ...parts(figures, gallery, show));
  } catch (error) {
    if (!signal.aborted) fill(place, notice(`The evaluation: ${error.message}`, { isBad: true }));
  }
}

function parts(figures, gallery, show) {
  const lights = (Array.isArray(figures.lights) ? figures.lights : []).slice(0, LIGHTS_MAX);
  const rows = [...lights.map((light) => row(light.name, light)), row("all lights", figures)];
  const about =
    `Indirect irradiance at ${figures.receivers} places, held against a path tracer: the root mean square error over the mean, ` +
    "the energy over the reference's, and by how much of the mean the worst 5 % and 1 % of the area differ.";
  const notes = (Array.isArray(figures.notes) ? figures.notes : []).map((note) => el("p", { class: "quiet small" }, String(note)));
  const ofLights = (Array.isArray(gallery?.lights) ? gallery.lights : []).map(({ name, words, pictures }) => {
    return el("details", {}, el("summary", {}, `${name}: ${words}`), picturesOf(pictures, show));
  });
  ofLights[0]?.setAttribute("open", "");
  const all = el("details", {}, el("summary", {}, "All figures"), shown(figures));
  return [el("p", { class: "quiet small" }, about), table(COLUMNS, rows), ...notes, ...ofLights, all];
}

function row(name, figures) {
  const { rel_rmse: error, energy_ratio: energy, p95, p99, interval_95: interval } = figures;
  const range = (of) => (Array.isArray(of) ? of.map(percent).join(" to ") : "");
  return [String(name), percent(error), range(interval?.rel_rmse), ratio(energy), ratios(interval?.energy_ratio), percent(p95), percent(p99)];
}

function percent(share) {
  return typeof share === "number" ? `${(100 * share).toFixed(1)} %` : "–";
}

function ratio(value) {
  return typeof value === "number" ? value.toFixed(3) : "–";
}

function ratios(of) {
  return Array.isArray(of) ? of.map(ratio).join(" to ") : "";
}
