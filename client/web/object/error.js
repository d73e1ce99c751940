// Why a file is no object that can be shown: the fault, its place, and what to do.

export class ObjectError extends Error {
  constructor(message) {
    super(message);
    this.name = "ObjectError";
  }
}

/** More of something than is read. */
export class LimitError extends ObjectError {}

/** A fault of a file that another export of it mends. */
export function broken(place, problem) {
  return new ObjectError(`${place}: ${problem}; export the file again`);
}

// Longest name shown in a message, in characters.
const SHOWN_MAX = 120;

/** A name from a file, cut to a length that fits into a message. */
export function shown(name) {
  const characters = [...name.slice(0, 4 * SHOWN_MAX)];
  return characters.length <= SHOWN_MAX ? name : `${characters.slice(0, SHOWN_MAX).join("")}…`;
}

/** `kind index ("name")`, as messages call things of a file. */
export function placeOf(kind, index, name) {
  return typeof name === "string" ? `${kind} ${index} ("${shown(name)}")` : `${kind} ${index}`;
}
