// Pictures with captions.

import { el } from "./dom.js";

/** Figures of a list of `{file, words, width, height}`; `show(image, file)` gives each image its picture. */
export function picturesOf(list, show) {
  const figures = list.map(({ file, words, width, height }) => {
    const image = el("img", { width, height, alt: words, loading: "lazy" });
    show(image, String(file));
    return el("figure", {}, image, el("figcaption", { class: "quiet small" }, words));
  });
  return el("div", { class: "pictures" }, figures);
}
