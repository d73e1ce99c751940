// Bounces since the last change of light, and the changes by them that were heard of; twin of client/src/frame/bounces.rs.

export class Bounces {
  count = 0;
  // Call of the first of them: answers before it are of other light.
  #firstCall = 0;
  // The latest answers, oldest first, no more than tell of a cycle.
  #heard = [];

  /** One more, whose change that call asks for. */
  add(call) {
    if (this.count === 0) this.#firstCall = call;
    this.count += 1;
  }

  /** Takes an answer, `{call, since, change}`. In each `cycle` bounces all clusters take part. */
  hear(answer, cycle) {
    if (this.count === 0 || answer.call < this.#firstCall) return;
    this.#heard.push(answer);
    while (this.#spanned(1) >= cycle) this.#heard.shift();
  }

  /** The change by the latest bounces that were heard of, as many as a cycle at least; null while they are fewer. */
  change(cycle) {
    return this.#spanned(0) >= cycle ? this.#heard.reduce((sum, { change }) => sum + change, 0) : null;
  }

  /** Bounces since the change that answers are of, without the first `leftOut` of these; an answer spans those whose own never came. */
  #spanned(leftOut) {
    const of = ({ call, since }) => call - Math.max(since, this.#firstCall - 1);
    return this.#heard.slice(leftOut).reduce((sum, answer) => sum + of(answer), 0);
  }
}
