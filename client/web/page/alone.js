// A page of one bake, from plain files: the bundle lies in the folder `bake` beside the page.

import { BundleSource } from "../fetch.js";
import { viewerOf } from "./viewer.js";

const bundle = new URL("bake", location.href);
viewerOf(document.querySelector("main"), new BundleSource(bundle.href), new AbortController().signal);
