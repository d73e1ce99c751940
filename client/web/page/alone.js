// A page of one bake, from plain files: the bundle lies in the folder `bake` beside the page; `site.json` tells what else there is.

import { BundleSource, Http } from "../fetch.js";
import { el, fill } from "./dom.js";
import { evaluationOf } from "./evaluation.js";
import { viewerOf } from "./viewer.js";

const { signal } = new AbortController();
const at = (name) => new URL(name, location.href).href;
const [picture, evaluation] = [el("div"), el("div")];
fill(document.querySelector("main"), picture, evaluation);
const contents = await new Http().json(at("site.json")).catch(() => ({}));
viewerOf(picture, new BundleSource(at("bake")), signal, { pictures: contents.stills ?? [], base: at(".") });
if (contents.evaluation) evaluationOf(evaluation, at("evaluation"), signal);
