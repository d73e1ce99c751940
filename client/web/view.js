// A bake on a canvas: light is seen as its clusters come, the camera circles a point, and one lamp can be moved.
//
//   const viewer = await Viewer.open(canvas, source, { onProgress: ({ words, share }) => … });
//   viewer.lamp.positionM = [0, 1, 0]; viewer.changed();
//   viewer.close();
//
// A drag turns the camera, a wheel or two fingers bring it nearer; a drag with the right button or with Shift moves the lamp, and one that
// begins on an object moves that over the floor.

import { Frame, SAMPLES_MAX, featuresOf, limitsOf } from "./frame/frame.js";
import { cameraOf, lightsOf } from "./frame/lights.js";
import { FetchError, sleep } from "./fetch.js";
import { distanceTo, footAt, onPlane, pointAt, rayThrough } from "./pick.js";
import { BakeStream } from "./relight/stream.js";
import { Orbit } from "./orbit.js";

/** Shares of the light's bytes after which it is shown anew; with a few clusters all come at once. */
const STAGES = [0.1, 0.4, 1];
const CLUSTERS_FEW = 24;
/** Most pixels along a side of the picture, however dense the screen is. */
const SIDE_MAX = 2048;
/** Time in which clusters of a bake that goes on land before they are taken, and the longest wait for them. */
const LANDING_MS = 1000;
const LISTEN_SECS = 25;
/** Failures in a row, each after some tries within seconds, of a server that may be there again: some minutes. */
const PATIENCE = 15;
/** Bounces before the first picture, and before one of a later stage. */
const BOUNCES_FIRST = 16;

/** A browser or machine without WebGPU: nothing is wrong with the bake. */
export class Unsupported extends Error {
  constructor(message) {
    super(message);
    this.name = "Unsupported";
  }
}

/** A device for frames. Throws `Unsupported` where there is none. */
export async function requestDevice() {
  if (navigator.gpu === undefined) throw new Unsupported("this browser has no WebGPU, or the page is not served over HTTPS");
  const adapter = await navigator.gpu.requestAdapter();
  if (adapter === null) throw new Unsupported("this browser has WebGPU, but no graphics adapter for it");
  return adapter.requestDevice({ requiredFeatures: featuresOf(adapter), requiredLimits: limitsOf(adapter) });
}

export class Viewer {
  #isClosed = false;
  // The error that has closed the view.
  #failure = null;
  // Something to draw has changed since the last picture.
  #isStale = true;
  // Light is being exchanged: its bounces are run there.
  #isLoading = false;
  // Exposure as the reader set it last.
  #wantedExposure = null;

  /**
   * Opens a bake; one that goes on, which `following` has heard of the outline of (`relight/following.js`), with the light that is baked:
   * the rest comes as it is. `onProgress` hears of the work under way, `share` is 1 when all is done. Later, `onTrouble` hears of errors that leave
   * the picture as it is, and `onFailure` of the one that has closed the view.
   */
  static async open(canvas, source, options = {}) {
    const { signal = null, following = null, onProgress = () => {}, onTrouble = () => {}, onFailure = () => {} } = options;
    const viewer = new Viewer();
    viewer.device = await requestDevice();
    try {
      await viewer.#open(canvas, source, { signal, following, onProgress, onTrouble, onFailure });
    } catch (error) {
      viewer.close();
      // The device is the cause, whatever failed for want of it.
      throw viewer.#failure ?? error;
    }
    return viewer;
  }

  async #open(canvas, source, { signal, following, onProgress, onTrouble, onFailure }) {
    this.device.lost.then(({ message }) => {
      if (this.#isClosed) return;
      this.#failure = new Error(`the graphics device is gone (${message}): open the page again`);
      this.close();
      onFailure(this.#failure);
    });
    onProgress({ words: "reading the scene", share: 0 });
    this.stream = await BakeStream.begin(source, { signal, following });
    this.#stopIfClosed();
    this.scene = this.stream.scene;
    this.canvas = canvas;
    await this.#firstLight(signal, onProgress);
    this.#stopIfClosed();
    const onError = (error) => signal?.aborted || this.#isClosed || onTrouble(error);
    this.#follow(canvas, onError);
    this.#refine(signal, onProgress).catch(onError);
  }

  /** Ends an opening whose view was closed meanwhile: `close` found nothing then of what has been made since. */
  #stopIfClosed() {
    if (this.#isClosed) throw this.#failure ?? new Error("the view was closed");
  }

  /** The first picture: of the overview, where there is one, else of all clusters. */
  async #firstLight(signal, onProgress) {
    const { manifest } = this.scene;
    const isFew = this.stream.clusters[1] <= CLUSTERS_FEW || !this.stream.hasOverview;
    this.stages = isFew ? [1] : STAGES;
    if (isFew) await this.#fetchUpTo(this.stages.shift(), signal, onProgress);
    this.#tellDrawing(onProgress);
    const camera = cameraOf(manifest) ?? Orbit.around(manifest.boundsM).camera();
    this.orbit = Orbit.of(camera, manifest.boundsM);
    this.context = this.canvas.getContext("webgpu");
    const format = navigator.gpu.getPreferredCanvasFormat();
    this.context.configure({ device: this.device, format, alphaMode: "opaque" });
    const [width, height] = this.#fit();
    const options = { width, height, format, camera: this.orbit.camera() };
    this.frame = await Frame.create(this.device, await this.stream.bake(), options);
    this.lights = [...lightsOf(manifest)];
    await this.frame.settle({ bouncesMax: BOUNCES_FIRST });
    this.frame.draw(this.context);
    this.usualExposure = await this.frame.expose();
    this.#addLamp(this.usualExposure);
    this.changed();
  }

  /** The lamp is the first light that shines from a place, else one more, as bright as the rest of the scene. */
  #addLamp(exposure) {
    const [low, high] = this.frame.boundsM;
    const diagonal = Math.hypot(...high.map((bound, axis) => bound - low[axis]));
    const shines = ({ strength }) => Math.max(...strength) > 0;
    const own = this.lights.findIndex((light) => ["point", "spot"].includes(light.kind.type) && shines(light));
    // Irradiance of middle grey at a sixth of the scene's size.
    const mean = (0.18 / exposure) * Math.PI * (diagonal / 6) ** 2;
    const isDark = !this.lights.some(shines) && this.scene.manifest.emitters.length === 0;
    const strength = isDark || !Number.isFinite(mean) ? diagonal ** 2 : mean;
    const made = {
      name: "lamp",
      kind: { type: "point", positionM: low.map((bound, axis) => 0.5 * (bound + high[axis])), rangeM: null },
      strength: [strength, strength, strength],
    };
    this.#lampAt = own < 0 ? this.lights.push(made) - 1 : own;
    const { kind, strength: full } = this.lights[this.#lampAt];
    /** Place in metres, and a factor on its strength. */
    this.lamp = { positionM: Array.from(kind.positionM), share: 1, strength: Array.from(full) };
  }

  #lampAt = -1;

  /** Lamp, exposure, emitters or camera have changed. */
  changed() {
    const { positionM, share, strength } = this.lamp;
    const lamp = this.lights[this.#lampAt];
    this.lights[this.#lampAt] = {
      ...lamp,
      kind: { ...lamp.kind, positionM: [...positionM] },
      strength: strength.map((channel) => channel * share),
    };
    this.frame.setLights(this.lights);
    this.frame.setCamera(this.orbit.camera());
    this.#isStale = true;
  }

  /** Materials whose colours can be changed, once each: `{material, baseColour}` as baked, linear. */
  get materials() {
    const { materials } = this.scene.manifest;
    const glass = new Set(materials.filter(({ glass }) => glass).map(({ name }) => name));
    const byName = new Map();
    for (const { name, baseColour } of materials) {
      if (!glass.has(name) && !byName.has(name)) byName.set(name, { material: name, baseColour: [...baseColour].slice(0, 3) });
    }
    return [...byName.values()];
  }

  /** Gives materials other colours, see `Frame.setMaterials`; the others have those of the bake. */
  setMaterials(colours) {
    this.frame.setMaterials(colours);
    this.#isStale = true;
  }

  /** Sets a panorama as the sky, see `Frame.setSky`. */
  async setSky(panorama, how) {
    await this.frame.setSky(panorama, how);
    this.#isStale = true;
  }

  /** Puts objects beside the bake, see `Frame.setObjects`. */
  async setObjects(objects, stances) {
    await this.frame.setObjects(objects, stances);
    this.#isStale = true;
  }

  /** Moves an object that is there to a stance; one that is not stays away. */
  moveObject(object, stance) {
    const index = this.frame.objects.objects.indexOf(object);
    if (index < 0) return;
    this.frame.moveObject(index, stance);
    this.#isStale = true;
  }

  /** Where an object is to be put so that it stands on what is seen at a place of the page, or in the middle of the picture, or below. */
  standAt(object, place = null) {
    const [low, high] = [[Infinity, Infinity, Infinity], [-Infinity, -Infinity, -Infinity]];
    for (const { positionM } of object.draws(0, 0)) {
      positionM.forEach((at, index) => {
        low[index % 3] = Math.min(low[index % 3], at);
        high[index % 3] = Math.max(high[index % 3], at);
      });
    }
    if (low[0] > high[0]) return [0, 0, 0];
    const radiusM = 0.5 * Math.hypot(high[0] - low[0], high[2] - low[2]);
    const [inner, outer] = this.frame.objects.ownBoundsM;
    const middle = inner.map((side, axis) => 0.5 * (side + outer[axis]));
    const foot = footAt(this.#rayAt(place), this.frame.objects.scene.draws, radiusM);
    const [x, y, z] = foot ?? [middle[0], inner[1], middle[2]];
    return [x - 0.5 * (low[0] + high[0]), y - low[1], z - 0.5 * (low[2] + high[2])];
  }

  /** The ray through a place of the page, or through the middle of the picture. */
  #rayAt(place) {
    const { left, top, width, height } = this.canvas.getBoundingClientRect();
    const at = place === null ? [0.5, 0.5] : [(place.clientX - left) / width, (place.clientY - top) / height];
    return rayThrough(this.orbit.camera(), at, width / height);
  }

  /** Takes hold of the object that is seen at a place of the page: a function that moves it over the floor; null where there is none. */
  #grab(place) {
    const { objects } = this.frame;
    if (objects.objects.length === 0) return null;
    const ray = this.#rayAt(place);
    const distances = objects.objects.map((_, index) => distanceTo(ray, objects.drawsOf(index)));
    const distance = Math.min(...distances);
    if (distance === Infinity || distanceTo(ray, this.scene.draws) < distance) return null;
    const object = objects.objects[distances.indexOf(distance)];
    let last = pointAt(ray, distance);
    const most = 4 * (distance + this.orbit.diagonalM);
    return (event) => {
      const next = onPlane(this.#rayAt(event), last[1], most);
      const index = this.frame.objects.objects.indexOf(object);
      if (next === null || index < 0) return;
      const stance = this.frame.objects.stances[index];
      const positionM = stance.positionM.map((at, axis) => at + next[axis] - last[axis]);
      last = next;
      this.moveObject(object, { ...stance, positionM });
      this.onObjectDragged?.(object, positionM);
    };
  }

  /** Sets levels of detail, see `Frame.setLod`; with null there is all detail. */
  async setLod(words) {
    await this.frame.setLod(words);
    this.#isStale = true;
  }

  /** Factor on radiance before the tone curve. */
  set exposure(exposure) {
    this.#wantedExposure = exposure;
    this.frame.exposure = exposure;
    this.#isStale = true;
  }

  get exposure() {
    return this.frame.exposure;
  }

  /** Clusters that came, and all. */
  get clusters() {
    return this.stream.clusters;
  }

  /** Fetches clusters until such a share of all bytes has come, those first that the picture needs most. */
  async #fetchUpTo(share, signal, onProgress) {
    const [come, all] = this.stream.bytes;
    const lit = await this.frame?.lit();
    const viewpoint = this.frame?.viewpoint ?? null;
    const onCluster = () => {
      const [came, wanted] = this.clusters;
      onProgress({ words: `light: ${came} of ${wanted} clusters`, share: this.#share });
    };
    await this.stream.refine(share < 1 ? share * all - come : Infinity, { lit, viewpoint, signal, onCluster });
  }

  /** Share of the work that is done: the last cluster is still to be drawn. */
  get #share() {
    const [came, wanted] = this.clusters;
    return came / (wanted + 1);
  }

  #tellDrawing(onProgress) {
    onProgress({ words: "drawing", share: this.#share });
  }

  /** Takes in the rest of the light, stage by stage. */
  async #refine(signal, onProgress) {
    for (const share of this.stages) {
      await this.#takeUpTo(share, signal, onProgress);
      if (this.#isClosed) return;
    }
    let [failures, isBehind] = [0, false];
    while (this.stream.isUnderWay || isBehind) {
      const [baked, all] = this.stream.cells;
      const { lost } = this.stream;
      const ofLost = lost > 0 ? `, the server has lost ${lost} clusters until they are baked again` : "";
      onProgress({ words: `the bake goes on: ${baked} of ${all} cells are baked${ofLost}`, share: baked / (all + 1) });
      await sleep(LANDING_MS, signal);
      try {
        const hasMore = this.stream.isUnderWay && (await this.stream.hear({ waitSecs: LISTEN_SECS, signal }));
        if (this.#isClosed) return;
        isBehind ||= hasMore;
        if (isBehind) await this.#takeUpTo(1, signal, onProgress);
        failures = 0;
      } catch (error) {
        failures += 1;
        if (!(error instanceof FetchError && error.mayPass) || failures > PATIENCE) throw error;
        continue;
      }
      if (this.#isClosed) return;
      if (isBehind) await this.#exposeAnew();
      isBehind = false;
    }
    // Its Workers have memory of all clusters.
    this.stream.close();
    onProgress({ words: "all light is here", share: 1 });
  }

  /** Fetches clusters, and shows their light. */
  async #takeUpTo(share, signal, onProgress) {
    await this.#fetchUpTo(share, signal, onProgress);
    if (this.#isClosed) return;
    this.#tellDrawing(onProgress);
    this.#isLoading = true;
    try {
      await this.frame.setLight((await this.stream.bake()).light);
    } finally {
      this.#isLoading = false;
    }
    this.#isStale = true;
  }

  /** Follows light that a bake which goes on has brought with the exposure, as much brighter or darker as the reader wants it. */
  async #exposeAnew() {
    this.frame.draw(this.context);
    const usual = await this.frame.expose();
    // The reader may have moved it meanwhile.
    const factor = this.#wantedExposure === null ? 1 : this.#wantedExposure / this.usualExposure;
    this.usualExposure = usual;
    this.exposure = factor * usual;
  }

  /** Pixels of the canvas on its screen; sets them. */
  #fit() {
    const { clientWidth, clientHeight } = this.canvas;
    const density = Math.min(devicePixelRatio, SIDE_MAX / Math.max(clientWidth, clientHeight, 1));
    const size = [clientWidth, clientHeight].map((side) => Math.max(1, Math.round(side * density)));
    [this.canvas.width, this.canvas.height] = size;
    return size;
  }

  /** Draws whenever something has changed or light still bounces, and hears of the reader's hand. */
  #follow(canvas, onError) {
    this.stopHand = this.orbit.follow(canvas, {
      changed: () => this.changed(),
      moveLamp: (byM) => {
        this.lamp.positionM = this.lamp.positionM.map((at, axis) => at + byM[axis]);
        this.onLampMoved?.();
      },
      lamp: () => this.lamp.positionM,
      grab: (event) => this.#grab(event),
    });
    this.resized = new ResizeObserver(() => {
      if (this.#isClosed || canvas.clientWidth === 0) return;
      this.frame.resize(...this.#fit()).catch((error) => {
        [canvas.width, canvas.height] = this.frame.size;
        onError(error);
      });
      this.#isStale = true;
    });
    this.resized.observe(canvas);
    let before = null;
    const draw = (nowMs) => {
      if (this.#isClosed) return;
      requestAnimationFrame(draw);
      if (this.frame.isBehind) return;
      // What plays moves on by the time between pictures.
      this.onFrame?.(before === null ? 0 : (nowMs - before) / 1000);
      before = nowMs;
      const isMoving = !this.#isLoading && !this.frame.settled;
      if (isMoving) this.frame.advance();
      // A picture that stands still gathers samples.
      if (isMoving || this.#isStale || this.frame.samples < SAMPLES_MAX) this.frame.draw(this.context);
      this.#isStale = false;
    };
    requestAnimationFrame(draw);
  }

  /** Ends drawing and frees the device. */
  close() {
    this.#isClosed = true;
    this.stream?.close();
    this.resized?.disconnect();
    this.stopHand?.();
    this.device.destroy();
  }
}
