// The reader's token, kept as long as the tab is open, and calls with it.

import { FetchError, Http } from "../fetch.js";

const KEY = "lightkiln-token";

/** Whether a token is kept. */
export function hasToken() {
  return sessionStorage.getItem(KEY) !== null;
}

/** Whether a header can carry a text as a token: visible ASCII alone. */
export function canBeToken(text) {
  return /^[\x21-\x7e]+$/.test(text);
}

export function keepToken(token) {
  sessionStorage.setItem(KEY, token);
}

export function forgetToken() {
  sessionStorage.removeItem(KEY);
}

/** Calls of the server that this page is from. */
export function http() {
  return new Http({ token: sessionStorage.getItem(KEY) });
}

/** Whether a call failed for want of a token that is good for it. */
export function wantsToken(error) {
  return error instanceof FetchError && (error.status === 401 || error.status === 403);
}
