// The lightmap's layout: pages, and the places of blocks in them; twin of client/src/scene/lightmap.rs.

import { Inconsistent } from "./inconsistent.js";
import { MAX_TEXELS } from "./slots.js";

// Most pages: layers of one texture.
const MAX_PAGES = 256;
// Longest side of a page in texels.
const MAX_PAGE_SIDE = 2 ** 14;
/** Marks a side of a draw that has no block. */
export const NO_BLOCK = -1;

/** Pages and blocks of a bake, in the manifest's order. */
export class LightmapLayout {
  #byKey = new Map();

  constructor({ lightmap }) {
    this.pages = lightmap?.pages ?? [];
    checkPages(this.pages);
    this.blocks = (lightmap?.blocks ?? []).map(({ key, page, origin, size }, index) => {
      checkBlock({ page, origin, size }, this.pages, index);
      if (this.#byKey.has(key)) {
        throw new Inconsistent(`block ${index}`, "has the key of another block");
      }
      this.#byKey.set(key, index);
      return { key, page, origin, size };
    });
  }

  /** Index of a block by its key, or NO_BLOCK. */
  blockIndex(key) {
    return this.#byKey.get(key) ?? NO_BLOCK;
  }

  /** Page and origin, then size, of a block as shaders read them; zeros when there is none. */
  placement(index) {
    const block = this.blocks[index];
    if (block === undefined) {
      return [0, 0, 0, 0, 0, 0, 0, 0];
    }
    return [block.page, ...block.origin, 0, ...block.size, 0, 0];
  }
}

function checkBlock({ page, origin, size }, pages, index) {
  const problem =
    pages[page] === undefined
      ? "lies in a page that does not exist"
      : size.includes(0)
       ? "has no texels"
       : size.some((length, axis) => origin[axis] + length > pages[page][axis])
        ? "does not fit into its page"
        : null;
  if (problem !== null) {
    throw new Inconsistent(`block ${index}`, problem);
  }
}

function checkPages(pages) {
  const wrong = (problem) => {
    throw new Inconsistent("atlas pages", problem);
  };
  if (pages.length > MAX_PAGES) {
    wrong(`${pages.length} of them, at most ${MAX_PAGES}`);
  }
  const bad = pages.find((page) => page.some((side) => side < 1 || side > MAX_PAGE_SIDE));
  if (bad) {
    wrong(`one is ${bad[0]} × ${bad[1]}, sides are 1..=${MAX_PAGE_SIDE}`);
  }
  const texels = pages.reduce((sum, [width, height]) => sum + width * height, 0);
  if (texels > MAX_TEXELS) {
    wrong(`${texels} texels, at most ${MAX_TEXELS}`);
  }
}
