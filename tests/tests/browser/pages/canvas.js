// Reads the canvas of a page of its own that says in its title how it stands.

const WAIT_MS = 50;

/** Waits until the title is `shown`: width, height, and hex digits of the pixels from the upper row on; or the words of one that `failed`. */
export async function picture() {
  while (!["shown", "failed"].includes(document.title)) await new Promise((later) => setTimeout(later, WAIT_MS));
  if (document.title === "failed") return { failed: document.getElementById("said").textContent };
  const canvas = document.querySelector("canvas");
  const { width, height } = canvas;
  const copy = new OffscreenCanvas(width, height).getContext("2d");
  copy.drawImage(canvas, 0, 0);
  const { data } = copy.getImageData(0, 0, width, height);
  return { size: [width, height], hex: Array.from(data, (byte) => byte.toString(16).padStart(2, "0")).join("") };
}
