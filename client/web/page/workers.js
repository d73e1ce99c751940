// The workers that were heard of lately.

import { sleep } from "../fetch.js";
import { el, fill, table } from "./dom.js";
import { http } from "./session.js";
import { lengthOf } from "./words.js";

const LOOK_MS = 3000;
const COLUMNS = [["Name"], ["Holds"], ["Threads", true], ["Memory", true], ["Labels"], ["Last heard", true]];

/** Shows workers in `main` until `signal` is raised. */
export async function showWorkers(main, signal) {
  for (;;) {
    const { workers } = await http().json("/v1/workers", { signal });
    fill(main, el("h1", {}, "Workers"), workers.length === 0 ? empty() : table(COLUMNS, workers.map(row)));
    do await sleep(LOOK_MS, signal);
    while (document.hidden);
  }
}

function empty() {
  return el(
    "div",
    { class: "card" },
    el("p", {}, "No worker was heard of lately. Start one on any machine:"),
    el("code", {}, `kiln worker --server ${location.origin}`),
  );
}

function row(worker) {
  return [
    worker.name,
    worker.holds.length === 0 ? el("span", { class: "quiet" }, "nothing") : worker.holds.join(", "),
    String(worker.threads),
    worker.memory_mib === 0 ? "–" : `${worker.memory_mib} MiB`,
    worker.labels.join(", "),
    `${lengthOf(Date.now() - worker.seen_ms)} ago`,
  ];
}
