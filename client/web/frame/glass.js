// Triangles of glass in the order in which they are drawn over what is behind them: the farthest first, by their middles; twin of
// client/src/passes/shade/panes.rs.

import { VERTEX_NUMBERS } from "../relight/draws.js";
import { transformed } from "./maths.js";

export class Glass {
  /** The glass of a scene. */
  constructor({ draws, manifest }) {
    this.panes = draws.flatMap(({ material, vertices, triangles }, draw) => {
      return manifest.materials[material].glass ? panesOf(draw, vertices, triangles) : [];
    });
  }

  /** Moves the triangles of a mesh that are of glass. */
  set(index, { vertices, triangles }) {
    const first = this.panes.findIndex(({ draw }) => draw === index);
    if (first < 0) return;
    panesOf(index, vertices, triangles).forEach((pane, at) => (this.panes[first + at] = pane));
  }

  /**
   * Corners of the triangles from the farthest to the nearest, of equally far ones the first of the scene before; and runs of
   * triangles of one draw, from and to.
   */
  farthestFirst(matrix) {
    // Depth is reversed: it grows towards the eye. A point beside or behind the eye is the nearest.
    const nearness = this.panes.map(({ middle }) => {
      const [, , z, w] = transformed(matrix, middle);
      return w > 0 ? z / w : Infinity;
    });
    const order = this.panes.map((_, index) => index);
    order.sort((a, b) => (nearness[a] === nearness[b] ? a - b : nearness[a] - nearness[b]));
    const runs = [];
    order.forEach((index, at) => {
      const { draw } = this.panes[index];
      if (runs.at(-1)?.draw === draw) {
        runs.at(-1).to = at + 1;
      } else {
        runs.push({ draw, from: at, to: at + 1 });
      }
    });
    return { corners: Uint32Array.from(order.flatMap((index) => this.panes[index].corners)), runs };
  }
}

function panesOf(draw, vertices, triangles) {
  const panes = [];
  for (let first = 0; first < triangles.length; first += 3) {
    const corners = Array.from(triangles.subarray(first, first + 3));
    const middle = [0, 1, 2].map((axis) => {
      return corners.reduce((sum, corner) => sum + vertices[VERTEX_NUMBERS * corner + axis], 0) / 3;
    });
    panes.push({ draw, corners, middle });
  }
  return panes;
}
