// Fields of JSON objects, each checked before it is used. Names become camelCase; a field that is not named is an error.

/** JSON that is not as it should be; `message` says where. */
export class FieldError extends Error {
  constructor(message) {
    super(message);
    this.name = "FieldError";
  }
}

/** Throws unless `good`; `where` is the field's path. */
function check(good, where, wanted) {
  if (!good) throw new FieldError(`${where} is not ${wanted}`);
}

/** A reader of text. */
export function text(value, where) {
  check(typeof value === "string", where, "a text");
  return value;
}

/** A reader of true and false. */
export function flag(value, where) {
  check(typeof value === "boolean", where, "true or false");
  return value;
}

/** A reader of anything. */
export function any(value, where) {
  check(value !== undefined, where, "there");
  return value;
}

/** A reader of whole numbers from 0 to `max`. */
export function whole(max) {
  return (value, where) => {
    check(Number.isSafeInteger(value) && value >= 0 && value <= max, where, `a whole number from 0 to ${max}`);
    return value;
  };
}

/** A reader of numbers, rounded to f32, in which they are finite. */
export function f32(value, where) {
  const number = typeof value === "number" ? Math.fround(value) : NaN;
  check(Number.isFinite(number), where, "a finite number");
  return number;
}

/** A reader of numbers as they are. */
export function f64(value, where) {
  check(typeof value === "number" && Number.isFinite(value), where, "a finite number");
  return value;
}

/** A reader of one of some texts. */
export function oneOf(...texts) {
  return (value, where) => {
    check(texts.includes(value), where, `one of ${texts.join(", ")}`);
    return value;
  };
}

/** A reader of lists, of `length` if one is given. */
export function listOf(read, length) {
  return (value, where) => {
    check(Array.isArray(value), where, "a list");
    check(length === undefined || value.length === length, where, `a list of ${length}`);
    return value.map((item, index) => read(item, `${where}[${index}]`));
  };
}

/** A reader of lists of `length` numbers, as a Float32Array. */
export function vector(length) {
  const read = listOf(f32, length);
  return (value, where) => Float32Array.from(read(value, where));
}

/** A reader of bounds `[lower, upper]`, as a Float32Array of six. */
export function bounds(value, where) {
  return Float32Array.from(listOf(listOf(f32, 3), 2)(value, where).flat());
}

/** A reader of what may be null or not there, which then is null. */
export function optional(read) {
  const reader = (value, where) => (value === null || value === undefined ? null : read(value, where));
  reader.mayBeAbsent = true;
  return reader;
}

/** A reader of what may not be there, which then is what `otherwise` gives. */
export function orElse(read, otherwise) {
  const reader = (value, where) => (value === undefined ? otherwise() : read(value, where));
  reader.mayBeAbsent = true;
  return reader;
}

/** A reader of maps from texts, as a Map. */
export function mapOf(read) {
  return (value, where) => {
    check(isObject(value), where, "an object");
    return new Map(Object.entries(value).map(([key, item]) => [key, read(item, `${where}.${key}`)]));
  };
}

/** A reader of objects with these fields, `{field_of_json: reader}`. */
export function object(readers) {
  const names = Object.entries(readers).map(([field, read]) => [field, camel(field), read]);
  return (value, where) => {
    check(isObject(value), where, "an object");
    const unknown = Object.keys(value).find((field) => !Object.hasOwn(readers, field));
    if (unknown !== undefined) throw new FieldError(`${where} has an unknown field '${unknown.slice(0, 40)}'`);
    const found = {};
    for (const [field, name, read] of names) {
      const isThere = Object.hasOwn(value, field);
      if (!isThere && read.mayBeAbsent !== true) throw new FieldError(`${where} has no field '${field}'`);
      found[name] = read(isThere ? value[field] : undefined, where === "" ? field : `${where}.${field}`);
    }
    return found;
  };
}

/** A reader of objects that one field, `tag`, tells apart: `{value_of_tag: fields}`. */
export function tagged(tag, kinds) {
  const readers = new Map(
    Object.entries(kinds).map(([kind, fields]) => [kind, object({ [tag]: oneOf(kind), ...fields })]),
  );
  return (value, where) => {
    check(isObject(value), where, "an object");
    const read = readers.get(value[tag]);
    check(read !== undefined, `${where}.${tag}`, `one of ${[...readers.keys()].join(", ")}`);
    return read(value, where);
  };
}

function isObject(value) {
  return typeof value === "object" && value !== null && !Array.isArray(value);
}

function camel(field) {
  return field.replace(/_([a-z0-9])/g, (_, letter) => letter.toUpperCase());
}
