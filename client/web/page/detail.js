// The control for levels of detail: by preset, or in the words of `--lod`.

import { el, fill, notice } from "./dom.js";

// Words of a choice that asks for others.
const OWN = "own";
const CHOICES = [["all", "All"], ["fine", "Fine"], ["balanced", "Balanced"], ["coarse", "Coarse"], [OWN, "In words …"]];
// Words that the field begins with: levels that change one thing each.
const EXAMPLE = "balanced level1=0.2,3,all,0,1";

/** A choice, a field for words that it may open, and a place for work and troubles. */
export function detailOf(viewer) {
  const choice = el("select", {}, CHOICES.map(([value, text]) => el("option", { value }, text)));
  const words = el("input", { type: "text", value: EXAMPLE, spellcheck: "false" });
  const told = el("div", { class: "told", role: "status" });
  const field = el("label", { class: "words", hidden: true }, el("span", {}, "Detail in words"), words);
  // The last call alone says how it ended.
  let calls = 0;
  const apply = async (text) => {
    const call = ++calls;
    let said = null;
    try {
      await viewer.setLod(text);
      said = workOf(viewer.frame.lodCounts);
    } catch (error) {
      said = notice(error.message, { isBad: true });
    }
    if (call === calls) fill(told, said);
  };
  choice.addEventListener("change", () => {
    field.hidden = choice.value !== OWN;
    apply(choice.value === OWN ? words.value : choice.value === "all" ? null : choice.value);
  });
  words.addEventListener("change", () => apply(words.value));
  return [el("label", {}, el("span", {}, "Detail"), choice), field, told];
}

/** Work that is left of all, in words; nothing with all detail. */
function workOf(counts) {
  if (counts === null) return null;
  const share = (part, whole) => Math.round((100 * part) / Math.max(whole, 1));
  const sum = (of) => counts.reduce((total, count) => total + of(count), 0);
  const receivers = share(sum((count) => count.receiversComputed / count.interval), sum((count) => count.receivers));
  const numbers = share(sum((count) => count.numbersRead / count.interval), sum((count) => count.numbers));
  return el("span", { class: "quiet small" }, `a bounce: ${receivers} % of the receivers, ${numbers} % of the numbers`);
}
