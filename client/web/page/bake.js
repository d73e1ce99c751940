// One bake: where it stands, its log as it happens, its report, and its picture.

import { ServerSource } from "../fetch.js";
import { Following, TASKS } from "../relight/following.js";
import { bar, el, fill, notice, stateMark, table } from "./dom.js";
import { evaluationOf } from "./evaluation.js";
import { FarmFiles } from "./evaluation_files.js";
import { shown } from "./report.js";
import { http } from "./session.js";
import { viewerOf } from "./viewer.js";
import { eventWords, lengthOf, shareDone, timeOf } from "./words.js";

/** Longest wait of a call for events. */
const WAIT_SECS = 25;
/** Lines of the log that are kept on the page. */
const LINES_MAX = 500;
const STAGES = [["Stage"], ["Tasks", true], ["Done"], ["Reused", true], ["Under way", true], ["Time", true]];

/** Shows a bake in `main` until `signal` is raised. */
export async function showBake(main, id, signal) {
  const path = `/v1/bakes/${encodeURIComponent(id)}`;
  let bake = await http().json(path, { signal });
  const [head, viewer, stages, report, evaluation] = Array.from({ length: 5 }, () => el("div"));
  const parts = { head, viewer, stages, report, evaluation, log: el("ol", { class: "log" }) };
  const settings = el("details", {}, el("summary", {}, "Settings"), shown(bake.settings ?? "the defaults of the kind"));
  fill(
    main,
    parts.head,
    parts.viewer,
    parts.report,
    parts.evaluation,
    el("h2", {}, "Progress"),
    parts.stages,
    el("h2", {}, "Log"),
    parts.log,
    settings,
  );
  let [early, isReported] = [null, false];
  for (let after = 0; ; ) {
    update(parts, bake);
    if (early === null && hasOutline(bake)) early = showEarly(parts.viewer, bake, signal);
    if (bake.state === "done" && !isReported) {
      isReported = true;
      showResult(parts, path, bake, early, signal);
    }
    const isAtEnd = ["done", "failed", "cancelled"].includes(bake.state);
    const wait = isAtEnd ? 0 : WAIT_SECS;
    const page = await http().json(`${path}/events?after=${after}&wait_secs=${wait}`, { signal });
    page.events.forEach((event) => addLine(parts.log, event));
    if (isAtEnd && page.events.length === 0) return;
    after = page.events.at(-1)?.seq ?? after;
    bake = page.bake;
  }
}

function update({ head, stages }, bake) {
  const share = shareDone(bake);
  const isUnderWay = bake.state === "running" || bake.state === "paused";
  const end = bake.finished_ms ?? Date.now();
  fill(
    head,
    el("h1", {}, bake.name || bake.id),
    el(
      "p",
      { class: "quiet small" },
      stateMark(bake.state),
      ` · kind ${bake.kind} · ${timeOf(bake.created_ms)} · ${lengthOf(end - bake.created_ms)} · `,
      el("span", { class: "mono" }, bake.id),
    ),
    isUnderWay ? bar(share, `${Math.round(100 * share)} % done`) : null,
    bake.failure === null ? null : notice(bake.failure, { isBad: true }),
    bake.results_lost > 0 ? notice(`${bake.results_lost} of its results were lost: bake the scene again`, { isBad: true }) : null,
  );
  fill(stages, table(STAGES, bake.stages.map(stageRow)));
}

function stageRow({ kind, total, done, reused, leased, cost_total: cost, cost_done: costDone, elapsed_ms: ms }) {
  const share = cost > 0 ? costDone / cost : done === total ? 1 : 0;
  return [kind, `${done} of ${total}`, bar(share, `${kind}: ${done} of ${total}`), String(reused), String(leased), lengthOf(ms)];
}

function addLine(log, { at_ms: ms, event }) {
  const line = el("li", {}, el("time", {}, timeOf(ms)), el("span", {}, eventWords(event)));
  if (event.type === "task_failed") line.lastChild.classList.add("failure");
  log.prepend(line);
  while (log.children.length > LINES_MAX) log.lastChild.remove();
}

/** Whether a bake goes on, and its scene can be seen. Without WebGPU pictures are shown at the end, if there are any. */
function hasOutline({ state, stages }) {
  if (navigator.gpu === undefined) return false;
  const plan = stages.find(({ kind }) => kind === TASKS.outline);
  return ["running", "paused"].includes(state) && plan !== undefined && plan.total > 0 && plan.done === plan.total;
}

/** Shows a bake that goes on with the light that is baked; answers whether the picture `stands`, and how to `close` it. A fault in it leaves the log. */
async function showEarly(place, bake, signal) {
  const source = new ServerSource({ http: http(), bake: bake.id });
  const following = new Following(source);
  const own = new AbortController();
  const either = AbortSignal.any([signal, own.signal]);
  const close = () => own.abort();
  try {
    const isDone = (await following.hear({ signal: either })) === "done";
    // The result of the plan may have been lost since.
    if (!isDone && following.manifest === null) return { state: { stands: false }, close };
    return { state: await viewerOf(place, source, either, { following: isDone ? null : following }), close };
  } catch (error) {
    if (!signal.aborted) fill(place, notice(`The picture: ${error.message}`, { isBad: true }));
    return { state: { stands: false }, close };
  }
}

/** Shows what a finished bake has: each part on its own, so that a fault in one leaves the others. `early` is of the picture that came before. */
function showResult(parts, path, bake, early, signal) {
  const source = new ServerSource({ http: http(), bake: bake.id });
  const attached = bake.evaluation == null ? null : FarmFiles.open(http(), path, signal);
  const show = async (image, file) => (await attached).show(image, file);
  const open = () => viewerOf(parts.viewer, source, signal, { pictures: stillsOf(attached), show });
  (early ?? Promise.resolve(null)).then((before) => {
    if (before?.state.stands || signal.aborted) return;
    before?.close();
    open();
  });
  showEvaluation(parts.evaluation, attached, bake.id, signal);
  http()
    .json(`${path}/report`, { signal })
    .then((report) => fill(parts.report, el("h2", {}, "Report"), el("div", { class: "card" }, shown(report))))
    .catch((error) => signal.aborted || fill(parts.report, notice(`The report: ${error.message}`, { isBad: true })));
}

/** Pictures for browsers without WebGPU; none where they cannot be had, as the evaluation's own part tells why. */
async function stillsOf(attached) {
  try {
    const stills = await (await attached)?.json("stills.json");
    return Array.isArray(stills) ? stills : [];
  } catch {
    return [];
  }
}

async function showEvaluation(place, attached, id, signal) {
  if (attached === null) {
    const command = `kiln evaluate ${id} --server ${location.origin} --out DIR --attach`;
    fill(place, el("h2", {}, "Evaluation"), el("p", { class: "quiet" }, "None is attached. ", el("code", {}, command), " makes one."));
    return;
  }
  try {
    await evaluationOf(place, await attached, signal);
  } catch (error) {
    if (!signal.aborted) fill(place, notice(`The evaluation: ${error.message}`, { isBad: true }));
  }
}
