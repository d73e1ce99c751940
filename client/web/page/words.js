// Numbers and times in words.

/** A time, and its date unless it is today's. */
export function timeOf(ms) {
  const time = new Date(ms);
  const isToday = time.toDateString() === new Date().toDateString();
  return isToday ? time.toLocaleTimeString() : time.toLocaleString();
}

/** A length of time in its two largest units. */
export function lengthOf(ms) {
  const seconds = Math.max(0, Math.round(ms / 1000));
  if (seconds < 60) return `${seconds} s`;
  if (seconds < 3600) return `${Math.floor(seconds / 60)} min ${seconds % 60} s`;
  return `${Math.floor(seconds / 3600)} h ${Math.floor((seconds % 3600) / 60)} min`;
}

/** Bytes with a unit. */
export function bytesOf(bytes) {
  const units = ["B", "KB", "MB", "GB"];
  let [at, value] = [0, bytes];
  for (; value >= 1000 && at < units.length - 1; at++) value /= 1000;
  return `${at === 0 ? value : value.toPrecision(3)} ${units[at]}`;
}

/** A number for people: four digits that count. */
export function numberOf(value) {
  if (Number.isInteger(value)) return value.toLocaleString("en");
  return String(Number(value.toPrecision(4)));
}

/** Share of a bake's cost that is done, of its stages so far. */
export function shareDone({ state, stages }) {
  const total = stages.reduce((sum, stage) => sum + stage.cost_total, 0);
  const done = stages.reduce((sum, stage) => sum + stage.cost_done, 0);
  if (state === "done") return 1;
  return total > 0 ? done / total : 0;
}

/** An event in words. */
export function eventWords({ type, ...event }) {
  const task = event.label ? `${event.kind} ${event.label}` : event.kind;
  switch (type) {
    case "submitted":
      return "submitted";
    case "planned":
      return `${event.tasks} tasks planned${event.reused > 0 ? `, ${event.reused} of them done before` : ""}`;
    case "task_started":
      return `${task}: begun by ${event.worker}${event.attempt > 1 ? `, attempt ${event.attempt}` : ""}`;
    case "task_done":
      return `${task}: done by ${event.worker} in ${lengthOf(event.elapsed_ms)}${event.note ? ` (${event.note})` : ""}`;
    case "task_failed":
      return `${task}: ${event.blame === "lost" ? "lost with" : "failed on"} ${event.worker}: ${event.message}${event.retry ? " (will be tried again)" : ""}`;
    case "lease_expired":
      return `${task}: taken back from ${event.worker}, ${event.took_too_long ? "which took too long" : "which was not heard"}`;
    case "task_released":
      return `${task}: given back by ${event.worker}`;
    case "result_lost":
      return `${task}: result lost, made again`;
    case "result_differs":
      return `${task}: another attempt gave other bytes for ${event.output}: a machine, or the task's code, is not to be trusted`;
    case "state":
      return `now ${event.state}`;
    default:
      return String(type);
  }
}
