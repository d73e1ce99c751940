// Levels of detail as people write them, as `--lod` takes them; twin of proto/src/words/lod.rs.

import { MAX_RANK } from "../relight/clusters.js";
import { LOD_LEVELS, LOD_PRESETS, NOWHERE, fullLevel, problemOfLod } from "../relight/lod.js";
import { fround, numberFrom, wholeFrom } from "../relight/numbers.js";
import { Words } from "./words.js";

const LOD =
  "fine|balanced|coarse [level1=distance,columns,rank,receivers,interval (distance in scene diagonals, or metres as 20m)] " +
  "[level2=…] [level3=…] [level0=…] [beside=f] [behind=f] [blend=share] [margin=share]";
const FACTORS = ["beside", "behind", "blend", "margin"];

/**
 * Reads a preset's name, words that change it, or both; words alone begin with the most detail everywhere. Levels that are not named and
 * begin nowhere have the receivers of the one before.
 */
export function lodFromText(text) {
  const parts = String(text).trim().split(/\s+/).filter((part) => part !== "");
  const preset = LOD_PRESETS.get(parts[0]);
  if (preset !== undefined) parts.shift();
  const base = preset ?? fullLod();
  const words = new Words(parts, LOD);
  let receivers = 0;
  const levels = base.levels.map((own, index) => {
    const named = words.text(`level${index}`);
    const level = named === undefined ? { ...own } : levelFrom(named);
    if (level === null) words.wrong(`'level${index}=${named}' is no level`);
    if (named === undefined && own.distance === NOWHERE) level.receivers = receivers;
    receivers = level.receivers;
    return level;
  });
  const factor = (name) => [name, fround(words.number([name], 0, 1e6) ?? base[name])];
  const lod = { levels, ...Object.fromEntries(FACTORS.map(factor)) };
  const problem = problemOfLod(lod);
  if (problem !== null) words.wrong(problem);
  words.end();
  return lod;
}

/** The most detail everywhere. */
function fullLod() {
  const { beside, behind, blend, margin } = LOD_PRESETS.get("balanced");
  const distance = (index) => (index === 0 ? { value: 0, isMetres: false } : NOWHERE);
  const levels = Array.from({ length: LOD_LEVELS }, (_, index) => fullLevel(distance(index)));
  return { levels, beside, behind, blend, margin };
}

/** A level of `distance,columns,rank,receivers,interval`; null where it is none. */
function levelFrom(text) {
  const [place, ofColumns, ofRank, ...rest] = text.split(",");
  const isMetres = place.endsWith("m");
  const distance = numberFrom(isMetres ? place.slice(0, -1) : place);
  const rank = ofRank === "all" ? MAX_RANK : wholeFrom(ofRank);
  const [columns, receivers, interval] = [ofColumns, ...rest].map(wholeFrom);
  const isLevel = rest.length === 2 && [distance, columns, rank, receivers, interval].every((value) => value !== null);
  return isLevel ? { distance: { value: distance, isMetres }, columns, rank, receivers, interval } : null;
}
