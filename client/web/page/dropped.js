// Files that are dropped on the picture: objects by their first bytes or their name, panoramas else.

const MAGIC = "glTF";
const NAME = /\.(glb|gltf)$/i;

/** Whether a file is an object's: what it begins with counts more than its name. */
async function isObject(file) {
  const start = new TextDecoder().decode(await file.slice(0, MAGIC.length).arrayBuffer());
  return start === MAGIC || (NAME.test(file.name) && !start.startsWith("#?"));
}

/** Hands files that are dropped on an element to `takeObject`, with the place of the drop, or to `takeSky`. */
export function followDrops(element, { takeObject, takeSky }) {
  element.addEventListener("dragover", (event) => event.preventDefault());
  element.addEventListener("drop", async (event) => {
    event.preventDefault();
    const place = { clientX: event.clientX, clientY: event.clientY };
    for (const file of [...(event.dataTransfer?.files ?? [])]) {
      const is = await isObject(file).catch(() => NAME.test(file.name));
      if (is) takeObject(file, place);
      else takeSky(file);
    }
  });
}
