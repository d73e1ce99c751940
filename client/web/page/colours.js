// Controls for the colours of a bake's materials.

import { el, fill, notice } from "./dom.js";

/** Folded controls, one for each name of materials; nothing where there is none. */
export function coloursOf(viewer) {
  const { materials } = viewer;
  if (materials.length === 0) return null;
  // Colours that are not the bake's, by name.
  const chosen = new Map();
  const told = el("div");
  const apply = () => viewer.setMaterials([...chosen].map(([material, baseColour]) => ({ material, baseColour })));
  const fields = materials.map(({ material, baseColour }) => {
    const input = el("input", { type: "color" });
    const show = () => (input.value = hexOf(chosen.get(material) ?? baseColour));
    show();
    input.addEventListener("input", () => {
      const before = chosen.get(material);
      chosen.set(material, colourOf(input.value));
      fill(told);
      try {
        apply();
      } catch (error) {
        // The picture keeps the colour from before.
        if (before === undefined) chosen.delete(material);
        else chosen.set(material, before);
        show();
        fill(told, notice(error.message, { isBad: true }));
      }
    });
    return { show, label: el("label", {}, input, el("span", {}, material || "(no name)")) };
  });
  const reset = el("button", { type: "button" }, "As baked");
  reset.addEventListener("click", () => {
    chosen.clear();
    apply();
    fill(told);
    fields.forEach(({ show }) => show());
  });
  const list = el("div", {}, fields.map(({ label }) => label));
  return el("details", { class: "colours" }, el("summary", {}, "Colours of materials"), list, reset, told);
}

/** A linear colour as a browser's control has it: `#rrggbb` in sRGB. */
export function hexOf(linear) {
  const byte = (value) => Math.round(255 * (value <= 0.0031308 ? 12.92 * value : 1.055 * value ** (1 / 2.4) - 0.055));
  return `#${linear.map((value) => byte(value).toString(16).padStart(2, "0")).join("")}`;
}

/** The linear colour of a control. */
export function colourOf(hex) {
  return [1, 3, 5].map((at) => {
    const value = parseInt(hex.slice(at, at + 2), 16) / 255;
    return value <= 0.04045 ? value / 12.92 : ((value + 0.055) / 1.055) ** 2.4;
  });
}
