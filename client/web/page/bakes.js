// The list of bakes, newest first.

import { sleep } from "../fetch.js";
import { bar, el, fill, notice, stateMark } from "./dom.js";
import { http } from "./session.js";
import { lengthOf, shareDone, timeOf } from "./words.js";

const PAGE = 30;
/** Time between looks at bakes under way. */
const LOOK_MS = 3000;

/** Shows bakes in `main` until `signal` is raised. */
export async function showBakes(main, signal) {
  const list = el("div");
  const more = el("button", { type: "button", hidden: true }, "Show older bakes");
  let limit = PAGE;
  let cards = new Map();
  const look = async () => {
    const wanted = limit;
    const { bakes, next } = await bakesUpTo(wanted, signal);
    // A later look shows more.
    if (wanted !== limit) return;
    cards = cardsOf(bakes, cards);
    place(list, bakes.length === 0 ? [empty()] : [...cards.values()].map(({ element }) => element));
    more.hidden = next === null || next === undefined;
  };
  more.addEventListener("click", () => {
    limit += PAGE;
    look().catch((error) => signal.aborted || fill(list, notice(error.message, { isBad: true })));
  });
  await look();
  fill(main, el("h1", {}, "Bakes"), list, more);
  for (;;) {
    await sleep(LOOK_MS, signal);
    if (!document.hidden) await look();
  }
}

async function bakesUpTo(limit, signal) {
  const bakes = [];
  let next = null;
  do {
    const query = `limit=${PAGE}${next === null ? "" : `&after=${next}`}`;
    const page = await http().json(`/v1/bakes?${query}`, { signal });
    bakes.push(...page.bakes);
    next = page.next ?? null;
  } while (next !== null && bakes.length < limit);
  return { bakes, next };
}

/** Cards of bakes by id, `{text, element}`: elements of those that look as before are kept, and with them the keyboard's focus. */
function cardsOf(bakes, before) {
  const entries = bakes.map((bake) => {
    const made = card(bake);
    const [kept, text] = [before.get(bake.id), made.outerHTML];
    if (kept === undefined) return [bake.id, { text, element: made }];
    if (kept.text !== text) kept.element.replaceChildren(...made.childNodes);
    return [bake.id, { text, element: kept.element }];
  });
  return new Map(entries);
}

/** Makes elements the children of a list; those that are in their place already are not moved. */
function place(list, elements) {
  const wanted = new Set(elements);
  for (const child of [...list.children]) if (!wanted.has(child)) child.remove();
  elements.forEach((element, at) => {
    if (list.children[at] !== element) list.insertBefore(element, list.children[at] ?? null);
  });
}

function empty() {
  return el(
    "div",
    { class: "card" },
    el("p", {}, "No bakes yet. Send the first one from a shell:"),
    el("code", {}, `kiln bake scene.glb --server ${location.origin}`),
  );
}

function card(bake) {
  const isUnderWay = bake.state === "running" || bake.state === "paused";
  const end = bake.finished_ms === null ? Date.now() : bake.finished_ms;
  const times = `${timeOf(bake.created_ms)} · ${isUnderWay ? "for" : "took"} ${lengthOf(end - bake.created_ms)}`;
  return el(
    "a",
    { class: "card bake", href: `#/bakes/${encodeURIComponent(bake.id)}` },
    el("span", { class: "name" }, bake.name || bake.id),
    stateMark(bake.state),
    el("span", { class: "quiet small" }, `${bake.kind} · ${times}`),
    el("span", { class: "quiet small mono" }, bake.id.slice(0, 8)),
    isUnderWay ? bar(shareDone(bake), `${Math.round(100 * shareDone(bake))} % done`) : null,
    bake.failure === null ? null : el("span", { class: "failure small" }, bake.failure),
  );
}
