// Pictures with captions.

import { el } from "./dom.js";

/** Figures of a list of `{file, words, width, height}`, whose files lie below `base`; links to a wrong place stay text. */
export function picturesOf(list, base) {
  const figures = list.map(({ file, words, width, height }) => {
    const image = el("img", { src: `${base}${file}`, width, height, alt: words, loading: "lazy" });
    return el("figure", {}, image, el("figcaption", { class: "quiet small" }, words));
  });
  return el("div", { class: "pictures" }, figures);
}
