// Texts of the shaders: those of the native client, joined there with the parts that they share, one file each.

// Names of the shaders; the server has each as `NAME.wgsl`.
const NAMES = [
  "atlas",
  "basis",
  "change",
  "direct-texels",
  "lod-fill",
  "lod-mark",
  "near",
  "near-lit",
  "panorama",
  "patches",
  "reconstruct",
  "shade",
  "shadow",
  "shadow-panes",
  "halve",
  "snap",
  "tone",
];

/** Fetches all shaders from a folder, by default that beside this module's: texts by name. */
export async function fetchShaders(folder = new URL("../shaders/", import.meta.url)) {
  const texts = NAMES.map(async (name) => {
    const response = await fetch(new URL(`${name}.wgsl`, folder));
    if (!response.ok) {
      throw new Error(`shader ${name} cannot be fetched: ${response.status} ${response.statusText}`);
    }
    return [name, await response.text()];
  });
  return new Map(await Promise.all(texts));
}
