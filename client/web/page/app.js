// The page: which part of it the address asks for, and the reader's token.

import { showBake } from "./bake.js";
import { showBakes } from "./bakes.js";
import { el, fill, notice } from "./dom.js";
import { canBeToken, forgetToken, hasToken, keepToken, wantsToken } from "./session.js";
import { showWorkers } from "./workers.js";

const main = document.getElementById("main");
const forget = document.getElementById("forget");
let shown = new AbortController();

/** The part of the page that an address asks for: `(main, signal)` shows it until the signal is raised. */
function partOf(hash) {
  const [part, id] = hash.replace(/^#\/?/, "").split("/");
  if (part === "bakes" && id) return (main, signal) => showBake(main, decoded(id), signal);
  return part === "workers" ? showWorkers : showBakes;
}

function decoded(text) {
  try {
    return decodeURIComponent(text);
  } catch {
    return text;
  }
}

function markPlace() {
  const isWorkers = location.hash.startsWith("#/workers");
  for (const link of document.querySelectorAll("nav a")) {
    const isHere = isWorkers === link.hash.startsWith("#/workers");
    if (isHere) link.setAttribute("aria-current", "page");
    else link.removeAttribute("aria-current");
  }
  forget.hidden = !hasToken();
}

async function show() {
  shown.abort();
  shown = new AbortController();
  const { signal } = shown;
  markPlace();
  fill(main, el("p", { class: "quiet" }, "Loading …"));
  try {
    await partOf(location.hash)(main, signal);
  } catch (error) {
    if (signal.aborted) return;
    if (wantsToken(error)) askForToken(error);
    else fill(main, notice(error.message, { isBad: true }), again());
  }
}

function again() {
  return el("button", { type: "button", onclick: show }, "Try again");
}

function askForToken(error) {
  const field = el("input", { type: "password", name: "token", autocomplete: "off", required: true });
  const submit = (event) => {
    event.preventDefault();
    const token = field.value.trim();
    if (canBeToken(token)) {
      keepToken(token);
      show();
      return;
    }
    fill(told, notice("A token has ASCII letters, digits and signs alone, and no spaces: copy it again.", { isBad: true }));
    field.focus();
  };
  const told = el("div", {}, hasToken() ? notice(error.message, { isBad: true }) : null);
  fill(
    main,
    el("h1", {}, "A token is needed"),
    told,
    el("p", {}, "This farm shows its bakes to those who have a token that may read. It is kept until this tab is closed."),
    el(
      "form",
      { class: "token", onsubmit: submit },
      el("label", {}, el("span", {}, "Token"), field),
      el("button", { class: "main", type: "submit" }, "Open"),
    ),
    el("p", { class: "quiet small" }, "The farm's operator makes one: ", el("code", {}, "kiln token create anna --scope read")),
  );
  field.focus();
}

forget.addEventListener("click", () => {
  forgetToken();
  show();
});
addEventListener("hashchange", show);
show();
