// A page of one bake, from plain files: the bundle lies in the folder `bake` beside the page; `site.json` tells what else there is.

import { BundleSource, Http } from "../fetch.js";
import { el, fill, notice } from "./dom.js";
import { evaluationOf } from "./evaluation.js";
import { FolderFiles } from "./evaluation_files.js";
import { viewerOf } from "./viewer.js";

const { signal } = new AbortController();
const at = (name) => new URL(name, location.href).href;
const [picture, evaluation] = [el("div"), el("div")];
fill(document.querySelector("main"), picture, evaluation);
const contents = readContents();
// The bake does not wait for the rest.
const site = new FolderFiles(at("."));
const pictures = contents.then(({ stills }) => stills);
viewerOf(picture, new BundleSource(at("bake")), signal, { pictures, show: (image, file) => site.show(image, file) });
if ((await contents).hasEvaluation) evaluationOf(evaluation, new FolderFiles(at("evaluation")), signal);

/** Pictures of the site, and whether it has an evaluation: neither without `site.json`. One that cannot be read is told of. */
async function readContents() {
  try {
    const { stills, evaluation: hasEvaluation } = (await new Http().json(at("site.json"), { signal })) ?? {};
    if (!Array.isArray(stills)) throw new Error("site.json lists no pictures: write the site again with 'kiln site'");
    return { stills, hasEvaluation };
  } catch (error) {
    if (error.status !== 404) fill(evaluation, notice(`Pictures and evaluation of this site: ${error.message}`, { isBad: true }));
    return { stills: [], hasEvaluation: false };
  }
}
