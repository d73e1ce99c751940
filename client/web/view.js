// A bake on a canvas: light is seen as its clusters come, the camera circles a point, and one lamp can be moved.
//
//   const viewer = await Viewer.open(canvas, source, { onProgress: ({ words, share }) => … });
//   viewer.lamp.positionM = [0, 1, 0]; viewer.changed();
//   viewer.close();
//
// A drag turns the camera, a wheel or two fingers bring it nearer; a drag with the right button or with Shift moves the lamp.

import { Frame, featuresOf } from "./frame/frame.js";
import { cameraOf, lightsOf } from "./frame/lights.js";
import { Orbit } from "./orbit.js";
import { BakeStream } from "./relight/stream.js";

/** Shares of the clusters' bytes that come before light is shown anew, and then the rest; few clusters come at once. */
const STAGES = [0.1, 0.4];
const CLUSTERS_FEW = 24;
/** Most pixels along a side of the picture, however dense the screen is. */
const SIDE_MAX = 2048;
/** Bounces before the first picture. */
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
  return adapter.requestDevice({ requiredFeatures: featuresOf(adapter) });
}

export class Viewer {
  #isClosed = false;
  // Something to draw has changed since the last picture.
  #isStale = true;
  // More samples would change the picture no more.
  #isSmooth = false;
  // Light is being exchanged: its bounces are run there.
  #isLoading = false;

  /** Opens a bake. `onProgress` is told what is under way, `onFailure` what ended the view later. */
  static async open(canvas, source, { signal = null, onProgress = () => {}, onFailure = () => {} } = {}) {
    const viewer = new Viewer();
    viewer.device = await requestDevice();
    try {
      await viewer.#open(canvas, source, { signal, onProgress, onFailure });
    } catch (error) {
      viewer.close();
      throw error;
    }
    return viewer;
  }

  async #open(canvas, source, { signal, onProgress, onFailure }) {
    this.device.lost.then(({ message }) => {
      if (!this.#isClosed) onFailure(new Error(`the graphics device is gone (${message}): open the page again`));
    });
    this.canvas = canvas;
    onProgress({ words: "reading the scene", share: 0 });
    this.stream = await BakeStream.begin(source, { signal });
    const { chunks, overview } = this.stream;
    const bytes = chunks.reduce((sum, chunk) => sum + chunk.bytes, 0);
    const isFew = chunks.length <= CLUSTERS_FEW || overview.length === 0;
    const stages = isFew ? [] : STAGES.map((share) => share * bytes);
    if (isFew) await this.stream.refine(Infinity, { signal });
    await this.#firstLight();
    this.#tell(onProgress);
    this.#follow(canvas);
    this.#refine(stages, signal, onProgress).catch((error) => signal?.aborted || this.#isClosed || onFailure(error));
  }

  /** The first picture: of the overview's light, or of all clusters where they have come. */
  async #firstLight() {
    const { manifest } = this.stream.scene;
    this.orbit = Orbit.of(cameraOf(manifest) ?? Orbit.around(manifest.boundsM).camera(), manifest.boundsM);
    this.context = this.canvas.getContext("webgpu");
    const format = navigator.gpu.getPreferredCanvasFormat();
    this.context.configure({ device: this.device, format, alphaMode: "opaque" });
    const [width, height] = this.#fit();
    const options = { width, height, format, camera: this.orbit.camera() };
    this.frame = await Frame.create(this.device, this.stream.bake(), options);
    this.lights = [...lightsOf(manifest)];
    await this.frame.settle({ bouncesMax: BOUNCES_FIRST });
    this.frame.draw(this.context);
    this.#addLamp(await this.frame.expose());
    this.changed();
  }

  /** Takes in the rest of the light, where the picture needs it most, stage by stage. */
  async #refine(stages, signal, onProgress) {
    for (const bytesMax of [...stages, Infinity]) {
      if (this.stream.isWhole) break;
      const { viewpoint } = this.frame;
      await this.stream.refine(bytesMax, { lit: await this.frame.lit(), viewpoint, signal });
      if (this.#isClosed) return;
      this.#tell(onProgress);
      this.#isLoading = true;
      try {
        await this.frame.setLight(this.stream.bake().light);
      } finally {
        this.#isLoading = false;
      }
      this.#isStale = true;
    }
    onProgress({ words: "all light is here", share: 1 });
  }

  #tell(onProgress) {
    const [came, all] = this.clusters;
    onProgress({ words: `light: ${came} of ${all} clusters`, share: all === 0 ? 0 : came / (all + 1) });
  }

  /** The lamp is the first light that has a place, else one more, as bright as the rest of the scene. */
  #addLamp(exposure) {
    const [low, high] = this.frame.boundsM;
    const diagonal = Math.hypot(...high.map((bound, axis) => bound - low[axis]));
    const own = this.lights.findIndex(({ kind }) => kind.type === "point" || kind.type === "spot");
    // Irradiance of middle grey at a sixth of the scene's size.
    const mean = (0.18 / exposure) * Math.PI * (diagonal / 6) ** 2;
    const isDark = this.lights.length === 0 && this.stream.scene.manifest.emitters.length === 0;
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

  /** Factor on radiance before the tone curve. */
  set exposure(exposure) {
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

  /** Pixels of the canvas on its screen; sets them. */
  #fit() {
    const { clientWidth, clientHeight } = this.canvas;
    const density = Math.min(devicePixelRatio, SIDE_MAX / Math.max(clientWidth, clientHeight, 1));
    const size = [clientWidth, clientHeight].map((side) => Math.max(1, Math.round(side * density)));
    [this.canvas.width, this.canvas.height] = size;
    return size;
  }

  /** Draws while something changes, light bounces or the picture becomes smoother, and hears of the reader's hand. */
  #follow(canvas) {
    this.stopHand = this.orbit.follow(canvas, {
      changed: () => this.changed(),
      moveLamp: (byM) => {
        this.lamp.positionM = this.lamp.positionM.map((at, axis) => at + byM[axis]);
        this.onLampMoved?.();
      },
      lamp: () => this.lamp.positionM,
    });
    this.resized = new ResizeObserver(() => {
      if (this.#isClosed || canvas.clientWidth === 0) return;
      this.frame.resize(...this.#fit());
      this.#isStale = true;
    });
    this.resized.observe(canvas);
    const draw = () => {
      if (this.#isClosed) return;
      const isMoving = !this.#isLoading && !this.frame.settled;
      if (isMoving) this.frame.advance();
      if (isMoving || this.#isStale || !this.#isSmooth) {
        const before = this.frame.samples;
        this.frame.draw(this.context);
        this.#isSmooth = !isMoving && this.frame.samples === before;
      }
      this.#isStale = false;
      requestAnimationFrame(draw);
    };
    requestAnimationFrame(draw);
  }

  /** Ends drawing and frees the device. */
  close() {
    this.#isClosed = true;
    this.resized?.disconnect();
    this.stopHand?.();
    this.device.destroy();
  }
}
