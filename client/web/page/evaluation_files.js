// Where the files of an evaluation are: in a folder beside the page, or attached to a bake of a farm, which opens them to the reader's
// token alone.

import { FetchError, Http, fetchChunk } from "../fetch.js";

/** Files below `base`. */
export class FolderFiles {
  constructor(base) {
    this.base = base.replace(/\/$/, "");
    this.http = new Http({ base: this.base });
  }

  json(name, signal) {
    return this.http.json(`/${name}`, { signal });
  }

  /** Gives an image its picture; a link to a wrong place stays text. */
  show(image, name) {
    image.src = `${this.base}/${name}`;
  }
}

/** Files attached to the bake at `path`, until `signal` is raised. */
export class FarmFiles {
  static async open(http, path, signal) {
    const { files } = await http.json(`${path}/evaluation`, { signal });
    return new FarmFiles(http, path, new Map(files.map((file) => [file.name, file])), signal);
  }

  constructor(http, path, files, signal) {
    this.source = { http, pathOf: (digest) => `${path}/evaluation/files/${digest}` };
    this.files = files;
    this.signal = signal;
  }

  async json(name) {
    return JSON.parse(new TextDecoder().decode(await this.bytes(name)));
  }

  /** Bytes of a file, verified. */
  async bytes(name) {
    const file = this.files.get(name);
    if (file === undefined) throw new FetchError("status", `the evaluation has no file '${name}'`, { status: 404 });
    return fetchChunk(this.source, file, { signal: this.signal });
  }

  /** Gives an image its picture once it comes near the part of the page that is seen. */
  show(image, name) {
    const near = new IntersectionObserver((entries) => {
      if (!entries.some(({ isIntersecting }) => isIntersecting)) return;
      near.disconnect();
      this.fill(image, name);
    }, { rootMargin: "50%" });
    near.observe(image);
    this.signal.addEventListener("abort", () => near.disconnect(), { once: true });
  }

  async fill(image, name) {
    try {
      const url = URL.createObjectURL(new Blob([await this.bytes(name)], { type: "image/png" }));
      // The image keeps its pixels; bytes behind an address stay until that is revoked.
      const revoke = () => URL.revokeObjectURL(url);
      image.addEventListener("load", revoke, { once: true });
      image.addEventListener("error", revoke, { once: true });
      this.signal.addEventListener("abort", revoke, { once: true });
      image.removeAttribute("loading");
      image.src = url;
    } catch (error) {
      if (!this.signal.aborted) image.alt += ` (${error.message})`;
    }
  }
}
