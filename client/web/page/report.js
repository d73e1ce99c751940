// A report or settings as lists of names and values, folded where they are deep.

import { el } from "./dom.js";
import { numberOf } from "./words.js";

/** Entries of a list that are shown. */
const ITEMS_MAX = 50;

/** A JSON value as elements. */
export function shown(value, name = "") {
  if (Array.isArray(value) && value.every((item) => typeof item !== "object" || item === null)) {
    return el("span", { class: "mono" }, value.slice(0, ITEMS_MAX).map(plain).join(", ") || "none");
  }
  if (Array.isArray(value)) {
    return value.slice(0, ITEMS_MAX).map((item, index) => folded(`${name} ${index + 1}`, item));
  }
  if (typeof value === "object" && value !== null) return fields(value);
  return el("span", {}, plain(value));
}

function fields(object) {
  const entries = Object.entries(object);
  const isDeep = ([, value]) => typeof value === "object" && value !== null && !isFlat(value);
  const flat = entries.filter((entry) => !isDeep(entry));
  const list = flat.flatMap(([name, value]) => [el("dt", {}, words(name)), el("dd", {}, shown(value, name))]);
  const deep = entries.filter(isDeep).map(([name, value]) => folded(words(name), value));
  return [flat.length === 0 ? null : el("dl", {}, list), ...deep].filter((part) => part !== null);
}

function isFlat(value) {
  return Array.isArray(value) && value.every((item) => typeof item !== "object" || item === null);
}

function folded(name, value) {
  return el("details", {}, el("summary", {}, name), shown(value, name));
}

function plain(value) {
  return typeof value === "number" ? numberOf(value) : String(value);
}

function words(name) {
  return name.replaceAll("_", " ");
}
