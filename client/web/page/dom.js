// Elements of the page. All text goes in as text, never as HTML, whoever wrote it.

/** An element with properties (`class`, `on…` handlers, attributes) and children, of which null is left out. */
export function el(tag, properties = {}, ...children) {
  const element = document.createElement(tag);
  for (const [name, value] of Object.entries(properties)) {
    if (value === null || value === undefined || value === false) continue;
    if (name.startsWith("on")) element.addEventListener(name.slice(2), value);
    else element.setAttribute(name, value === true ? "" : value);
  }
  element.append(...children.flat().filter((child) => child !== null && child !== undefined));
  return element;
}

/** Puts children in the place of those that an element has. */
export function fill(element, ...children) {
  element.replaceChildren(...children.flat().filter((child) => child !== null && child !== undefined));
}

/** A line that says how something stands, for readers of screens too. */
export function notice(text, { isBad = false } = {}) {
  return el("p", { class: isBad ? "notice bad" : "notice", role: isBad ? "alert" : "status" }, text);
}

// Steps of a slider from one end to the other.
const STEPS = 200;

/** A slider from 0 to 1: its label, and `set`, which moves it. */
export function slider(name, changed) {
  const input = el("input", { type: "range", min: 0, max: STEPS });
  input.addEventListener("input", () => changed(Number(input.value) / STEPS));
  const set = (share) => (input.value = String(Math.round(STEPS * Math.max(0, Math.min(1, share)))));
  return { label: el("label", {}, el("span", {}, name), input), set };
}

/** A state with its mark. */
export function stateMark(state) {
  return el("span", { class: `state ${/^[a-z]+$/.test(state) ? state : ""}` }, state);
}

/** A bar of a share, with words for readers of screens. */
export function bar(share, label) {
  return el("progress", { max: 1, value: share, "aria-label": label });
}

/** A table with a head; columns are `[title, isNumber]`. */
export function table(columns, rows) {
  const cell = (tag, content, isNumber) => el(tag, { class: isNumber ? "number" : null }, content);
  const head = el("tr", {}, columns.map(([title, isNumber]) => cell("th", title, isNumber)));
  const body = rows.map((row) => el("tr", {}, row.map((content, at) => cell("td", content, columns[at][1]))));
  return el("div", { class: "table" }, el("table", {}, el("thead", {}, head), el("tbody", {}, body)));
}
