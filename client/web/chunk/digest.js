// blake3 digests as 64 lower-case hex digits: names of chunks, and checks of their prefixes.

import { blake3 } from "../vendor/noble-hashes/blake3.js";
import { ChunkError } from "./error.js";

/** Digits of the check of a prefix: eight bytes of its digest. */
const CHECK_DIGITS = 16;

/** Lower-case hex digits of bytes. */
export function hexOf(bytes) {
  return Array.from(bytes, (byte) => byte.toString(16).padStart(2, "0")).join("");
}

/** Digest of `bytes`. */
export function digestOf(bytes) {
  return hexOf(blake3(bytes));
}

/** Whether a text is a digest. */
export function isDigest(text) {
  return typeof text === "string" && /^[0-9a-f]{64}$/.test(text);
}

/** Throws unless `digest` is the digest of `bytes`. */
export function verify(digest, bytes) {
  const found = digestOf(bytes);
  if (found === digest) return;
  throw new ChunkError("digest", `the chunk's digest is ${found}, wanted ${digest}: fetch it again`);
}

/** Throws unless `check` is the check of the prefix `bytes`. */
export function verifyPrefix(check, bytes) {
  const found = digestOf(bytes).slice(0, CHECK_DIGITS);
  if (found === check) return;
  throw new ChunkError("digest", `the check of the chunk's first bytes is ${found}, wanted ${check}: fetch them again`);
}
