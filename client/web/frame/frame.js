// A frame that stays: a change of lights, emitters or camera writes to buffers and makes none, and nothing waits for the device.
//
//   setLights ───▶ shadow maps ─▶ direct ─▶ bounce, bounce, … ─▶ publish ─▶ draw
//   setEmitters ──────────────────────────▶    (advance: once a frame, until they change nothing)
//   setMaterials ───────────────▶ direct ─▶
//   setSky ────────────────────────────────▶    (another picture makes a texture)
//   setObjects, moveObjects ─▶ shadow maps ─▶ direct ─▶    (setObjects makes buffers)
//   setLod ───────▶ detail of clusters ───▶
//   setCamera ───▶ cascades of suns ─────────────────────────────────────▶ draw
//
// Twin of client/src/frame. Bounces go on from the light that there is: after a small change a few are enough.

import { LodPlan } from "../relight/lod_plan.js";
import { Tints } from "../relight/recolour.js";
import { isBlack, skyOf } from "../relight/sky.js";
import { Bounces } from "./bounces.js";
import { heard } from "./device.js";
import { Film, SAMPLES_MAX, jitterOf } from "./film.js";
import { Gpu, errorsOf } from "./gpu.js";
import { halves } from "./halves.js";
import { cameraOf, castersOf, checkLights, checkScale, lightsOf } from "./lights.js";
import { lodFromText } from "./lod_words.js";
import { Meshes } from "./meshes.js";
import { ObjectSet } from "./objects.js";
import { LightPasses } from "./passes.js";
import { ShadowPlan, checkRoom } from "./plan.js";
import { FOUR } from "./resident.js";
import { roomWith } from "./room.js";
import { isSame } from "./same.js";
import { fetchShaders } from "./shaders.js";
import { ShadowPass } from "./shadow.js";
import { measuredSnap } from "./snap.js";
import { Stage } from "./stage.js";
import { TONES, TonePass, automaticExposure } from "./tone.js";
import { ALL_DETAILS, eyeOf, lodEyeOf, shadeView } from "./view.js";

/** Relative change of E_ind by a bounce below which light has settled. */
export const CHANGE_MAX = 1e-3;
// Most bounces of `settle`.
const BOUNCES_MAX = 200;

export { SAMPLES_MAX };
export { featuresOf, limitsOf } from "./device.js";

export class Frame {
  #casters = [];
  #sky = skyOf([]);
  // A panorama with its turn, its strength, and the means of the sky's parts before it; null without one.
  #panorama = null;
  #emitterScale = [];
  // Colours of materials; null until the scene is there.
  #tints = null;
  #camera;
  #plan;
  #stage;
  // Work that changes have left to do: all shadow maps and E_dir; E_dir alone; cascades alone; black E_ind; pages.
  #stale = { lights: true, direct: true, cascades: true, light: true, pages: true };
  #film = new Film();
  // Bounces since the last change, and the changes by them that were heard of.
  #bounces = new Bounces();
  #details = ALL_DETAILS;
  // Levels of detail, and the detail of each cluster for the eye; null for all of it.
  #lod = null;
  #lodPlan = null;
  // Number of the next bounce.
  #turn = 0;
  // Ends when the last `setLight`, `setSky` or `setLod` has: they take turns.
  #lightTurn = Promise.resolve();
  // The last size that the device had memory for.
  #sizeKept;

  /**
   * Uploads a bake and makes all buffers and pipelines. Options:
   *   width, height   of the picture in pixels
   *   format          of what is drawn into, a canvas' by default
   *   shaders         texts by name; fetched by default
   *   camera, lights  the bake's own by default
   *   shadows         room for lights and maps: {lights, faces, side}
   */
  static async create(device, bake, options) {
    const frame = new Frame();
    const shaders = options.shaders ?? (await fetchShaders());
    frame.gpu = new Gpu(device, shaders);
    frame.bake = bake;
    await heard(device, () => frame.#make(options));
    return frame;
  }

  async #make({ width, height, format, camera, lights, shadows }) {
    const { gpu, bake } = this;
    const { manifest } = bake.scene;
    this.#tints = new Tints(bake.scene, []);
    /** Objects beside the bake, and bounds of the scene with them. */
    this.objects = new ObjectSet(bake.scene, [], []);
    this.boundsM = this.objects.boundsWith();
    const own = lights ?? lightsOf(manifest);
    this.room = shadows ?? roomWith(castersOf(own));
    checkRoom(this.room);
    this.size = [width, height];
    this.#sizeKept = this.size;
    this.snap = await measuredSnap(gpu);
    this.meshes = await Meshes.create(gpu, bake.scene);
    this.shadow = await ShadowPass.create(gpu, this.room);
    this.light = await LightPasses.create(gpu, bake, this.shadow);
    this.tone = await TonePass.create(gpu, format ?? navigator.gpu.getPreferredCanvasFormat());
    this.#show(await this.#staged(this.objects));
    // Factor on radiance before the tone curve, and the curve.
    [this.exposure, this.curve] = [1, "filmic"];
    const seen = camera ?? cameraOf(manifest);
    if (seen === null) throw new Error("the bake has no camera: give one");
    this.#plan = this.#planned([], null);
    this.setCamera(seen);
    this.#writeUnshadowed();
    this.setLights(own);
  }

  /** Sets lights and skies. Errs, and changes nothing, where they are more than the room holds. */
  setLights(lights) {
    checkLights(lights);
    const casters = castersOf(lights);
    const plan = this.#planned(casters, eyeOf(this.#camera));
    const sky = skyOf(lights);
    if (!isSame(casters, this.#casters)) {
      [this.#casters, this.#plan] = [casters, plan];
      this.shadow.set(plan);
      Object.assign(this.#stale, { lights: true, cascades: true });
    } else if (isSame(sky, this.#sky)) {
      return;
    }
    this.#sky = sky;
    this.#writeUnshadowed();
  }

  /**
   * Sets a panorama (`Panorama`) as the sky, on top of skies among the lights, turned by degrees about the vertical and scaled; null
   * takes it away. Waits for its means, and for calls of `setLight` before. Another picture makes a texture; its turn and strength make
   * nothing. Errs, and changes nothing, for numbers that cannot be, and where the device has no room for it.
   */
  setSky(panorama, { turnDeg = 0, strength = 1 } = {}) {
    return this.#inTurn(() => this.#takeSky(panorama, turnDeg, strength));
  }

  async #takeSky(panorama, turnDeg, strength) {
    panorama?.check(turnDeg, strength);
    const means = await panorama?.means(turnDeg, this.bake.light.columns.skyParts);
    await heard(this.gpu.device, () => this.shade.setPanorama(panorama, turnDeg, strength));
    this.#panorama = panorama && { panorama, turnDeg, strength, means };
    this.#writeUnshadowed();
  }

  /**
   * Puts objects (`SceneObject`) beside the bake in the place of all that are there, each with its stance, see `REST`; where none is given
   * an object stays where it is, and a new one stands at the origin. This makes buffers, and waits, also for calls of `setLight` before.
   * Errs, and changes nothing, where meshes contradict themselves, and where the device has too little memory.
   */
  setObjects(objects, stances = []) {
    return this.#inTurn(() => this.#takeObjects([...objects], [...stances]));
  }

  async #takeObjects(objects, stances) {
    const before = this.objects;
    const set = new ObjectSet(this.bake.scene, objects, before.stancesFor(objects, stances));
    const former = this.#stage;
    this.#show(await this.#staged(set));
    former.destroy();
    this.objects = set;
    const boundsM = set.boundsWith();
    this.#replan(this.#planned(this.#casters, eyeOf(this.#camera), boundsM), boundsM);
    this.#setLooks();
    // Some may have moved meanwhile.
    this.moveObjects(before.stancesFor(objects, stances));
  }

  #staged(set) {
    const { meshes, shadow, light, size } = this;
    return Stage.create(this.gpu, set, { meshes, shadow, atlas: light.atlas, size, sky: this.#panorama });
  }

  #show(stage) {
    this.#stage = stage;
    this.shade = stage.shade;
    if (this.shade.size !== this.size) this.shade.resize(this.size);
    this.tone.bind(this.shade.targetView, this.size);
    this.shadow.take(stage.casters);
  }

  /** Moves objects to stances, one each; those without one come to rest. Their shadows fall on all that lights reach. Makes nothing. */
  moveObjects(stances) {
    const moved = this.objects.moved(stances);
    if (moved.length === 0) return;
    const boundsM = this.objects.boundsWith(moved);
    const plan = this.#planned(this.#casters, eyeOf(this.#camera), boundsM);
    this.objects.take(moved, (index, mesh) => this.shade.moveMesh(index, mesh));
    this.#replan(plan, boundsM);
  }

  /** Moves one object, by its number from 0; the others stay. */
  moveObject(index, stance) {
    const stances = this.objects.stances;
    if (!(index in stances)) throw new Error(`object ${index} is to move, and there are ${stances.length}`);
    this.moveObjects(stances.with(index, stance));
  }

  /** Draws all shadow maps anew, within bounds. */
  #replan(plan, boundsM) {
    [this.#plan, this.boundsM] = [plan, boundsM];
    this.shadow.set(plan);
    Object.assign(this.#stale, { lights: true, cascades: true });
    this.#begin();
  }

  /** Sets the emitters' strengths, one factor each; 1 where absent. */
  setEmitters(scale) {
    checkScale(scale);
    if (!isSame(Array.from(scale), this.#emitterScale)) {
      this.#emitterScale = Array.from(scale);
      this.#writeUnshadowed();
    }
  }

  /**
   * Gives materials other linear base colours than the bake's, `{material, baseColour}` by name; those that are not named have the bake's
   * own. Errs, and changes nothing, for a colour that cannot be, see `Tints`.
   */
  setMaterials(colours) {
    const { scene, light } = this.bake;
    const tints = new Tints(scene, colours);
    if (isSame(tints.plain, this.#tints.plain)) return;
    this.light.setAlbedo(tints.albedo(scene, light.receivers));
    this.#tints = tints;
    this.#setLooks();
    // Near hits have albedo and light from lights in one sum.
    this.#stale.direct = true;
    this.#begin();
  }

  #setLooks() {
    this.shade.setLooks(this.#tints, this.#emitterScale);
  }

  /** Shows normal maps and specular reflection, `{normalMaps, specular}`, or leaves them out. */
  setDetails(details) {
    this.#details = { ...ALL_DETAILS, ...details };
    this.#film.clear();
  }

  /** Sets the camera. */
  setCamera(camera) {
    const vectors = ["eyeM", "targetM", "up"].map((name) => [name, Array.from(camera[name])]);
    const own = { ...camera, ...Object.fromEntries(vectors) };
    // Errs for a camera that sees nothing.
    shadeView(own, this.size, this.boundsM, this.#sky, [0, 0]);
    const plan = this.#planned(this.#casters, eyeOf(own));
    this.#camera = own;
    this.#film.clear();
    if (!plan.hasFacesOf(this.#plan)) {
      this.#plan = plan;
      this.shadow.set(plan);
      this.#stale.cascades = true;
    }
    this.#planLod();
  }

  get camera() {
    return this.#camera;
  }

  /**
   * Sets levels of detail in the words of `--lod`, as "balanced" or "coarse level2=20m,4,all,1,2"; with null there is all detail. The
   * first ones make buffers, and wait, also for calls of `setLight` before. Errs, and changes nothing, for words that are none, and where
   * the device has too little memory. A parallel camera sees all alike: under it there is all detail.
   */
  setLod(words) {
    return this.#inTurn(() => this.#takeLod(words === null ? null : lodFromText(words)));
  }

  async #takeLod(lod) {
    if (lod !== null && this.light.lod === null) await heard(this.gpu.device, () => this.light.makeLod());
    this.#lod = lod;
    this.#planLod();
  }

  /** Work by level, the finest first, see `LodPlan.counts`; null where there is all detail. */
  get lodCounts() {
    return this.#lodPlan?.counts(this.bake.light.clusters) ?? null;
  }

  /** Plans the detail of each cluster for the eye: light changes wherever the eye has moved. */
  #planLod() {
    const eye = this.#lod && lodEyeOf(this.#camera, this.size, this.objects.ownBoundsM);
    const before = this.#lodPlan;
    if (before?.lod === this.#lod && isSame(before.eye, eye)) return;
    if (before === null && eye === null) return;
    const { lod, clusters } = this.bake.light;
    this.#lodPlan = eye && new LodPlan(lod, clusters, this.#lod, eye, before);
    this.light.lod.set(this.#lodPlan);
    this.#begin();
  }

  #inTurn(take) {
    const taken = this.#lightTurn.then(take);
    this.#lightTurn = taken.catch(() => {});
    return taken;
  }

  /**
   * Takes other light of the same scene, as when more clusters have come: it is shown once it has settled. This makes buffers, and
   * waits, also for calls before it. Errs, and keeps the light that there is, where the device has too little memory for both.
   */
  setLight(light, limit) {
    return this.#inTurn(() => this.#takeLight(light, limit));
  }

  async #takeLight(light, limit) {
    const [before, bake] = [this.light, { ...this.bake, light }];
    const passes = await LightPasses.heard(this.gpu, bake, this.shadow, this.#lod !== null);
    await before.change.idle();
    [this.light, this.bake, this.#lodPlan] = [passes, bake, null];
    this.#planLod();
    if (!this.#tints.isEmpty) passes.setAlbedo(this.#tints.albedo(bake.scene, light.receivers));
    Object.assign(this.#stale, { direct: true, light: true });
    this.#writeUnshadowed();
    const settled = await this.settle(limit);
    this.shade.setPages(passes.atlas);
    this.#film.clear();
    before.destroy();
    return settled;
  }

  /**
   * Makes the picture of another size at once; this alone makes textures. Then errs, with the picture of the size before, where the
   * device has too little memory for it.
   */
  async resize(width, height) {
    const size = [width, height];
    const ended = errorsOf(this.gpu.device);
    this.#setSize(size);
    const error = await ended();
    if (error === null) {
      this.#sizeKept = size;
      return;
    }
    // Later calls may have set another.
    if (this.size === size) this.#setSize(this.#sizeKept);
    throw error;
  }

  #setSize(size) {
    this.size = size;
    this.shade.resize(this.size);
    this.#film.clear();
    this.tone.bind(this.shade.targetView, this.size);
    this.#planLod();
  }

  /** One bounce more, and before it what changes ask for. Waits for nothing; answers the bounces since the last change. */
  advance() {
    this.#drawShadows();
    const { eInd } = this.light.resident;
    this.light.lod?.setTurn(this.#turn);
    this.#turn = (this.#turn + 1) % 2 ** 32;
    this.gpu.submit((encoder) => {
      if (this.#stale.light) encoder.clearBuffer(eInd);
      this.light.bounce(encoder);
    });
    Object.assign(this.#stale, { light: false, pages: true });
    this.#film.clear();
    const [bounces, cycle] = [this.#bounces, this.#cycle];
    const call = this.light.change.ask((answer) => {
      // Light that is no number stays none.
      if (!Number.isFinite(answer.change)) this.#stale.light = true;
      bounces.hear(answer, cycle);
    });
    bounces.add(call);
    return bounces.count;
  }

  /** Bounces in which each cluster takes part once at least. */
  get #cycle() {
    return this.#lodPlan?.cycle ?? 1;
  }

  /** Whether the last bounces that were heard of, in which each cluster took part, changed light by little. */
  get settled() {
    return this.#isSettled(CHANGE_MAX);
  }

  #isSettled(changeMax) {
    const change = this.#bounces.change(this.#cycle);
    return change !== null && change < changeMax;
  }

  /** Bounces until they change less than a limit, each waited for: their number, and whether they converged. It ends in play, too. */
  async settle({ bouncesMax = BOUNCES_MAX, changeMax = CHANGE_MAX } = {}) {
    for (let left = bouncesMax - this.#bounces.count; left > 0 && !this.#isSettled(changeMax); left--) {
      this.advance();
      await this.light.change.idle();
    }
    return { bounces: this.#bounces.count, converged: this.#isSettled(changeMax) };
  }

  /**
   * Draws one sample per pixel with the light of the last bounce, into a texture view or a canvas' context. While nothing changes,
   * samples of later calls are added, so that a picture that stands still becomes smooth. With a `jitter`, pixels (right, down)
   * from the pixels' middles, the picture is of that sample alone.
   */
  draw(target, jitter = null) {
    this.#drawShadows();
    const { exposure, curve } = this;
    const into = target.getCurrentTexture?.().createView() ?? target;
    const sample = this.#film.next(exposure, curve, jitter !== null);
    this.gpu.submit((encoder) => {
      if (sample < SAMPLES_MAX) {
        const view = shadeView(this.#camera, this.size, this.boundsM, this.#sky, jitter ?? jitterOf(sample), this.#details);
        if (this.#stale.pages) this.light.publish(encoder);
        this.#stale.pages = false;
        this.shade.record(encoder, view);
        this.tone.add(encoder, { exposure, curve: TONES[curve], sample });
        this.#film.samples = sample + 1;
      }
      this.tone.show(encoder, into);
    });
    this.#film.handed(this.gpu.device);
  }

  /** The device is so far behind that calls before it has caught up would only delay the pictures: leave out this frame. */
  get isBehind() {
    return this.#film.isBehind;
  }

  /** Samples of the picture as it is, at most SAMPLES_MAX: more calls of `draw` change it no more. */
  get samples() {
    return this.#film.samples;
  }

  /** Sets the exposure by the picture drawn last, after a wait, and answers it. */
  async expose() {
    this.exposure = automaticExposure(await this.readRadiance());
    return this.exposure;
  }

  /** The picture drawn last, after a wait: rgb radiance in W·m⁻²·sr⁻¹, alpha 1 on surfaces. */
  async readRadiance() {
    const is32 = this.shade.format === "rgba32float";
    const bytes = await this.gpu.readLayer(this.shade.target, 0, is32 ? 16 : 8);
    return is32 ? new Float32Array(bytes) : halves(new Uint16Array(bytes));
  }

  /** E_ind of receivers by slot after the last bounce, after a wait: four numbers each, W·m⁻². */
  async readIndirect() {
    const { eInd, receiverCount } = this.light.resident;
    if (receiverCount === 0) return new Float32Array(0);
    return new Float32Array(await this.gpu.read(eInd, FOUR * receiverCount));
  }

  /** Places of receivers and their light, after a wait, for `BakeStream.refine`. */
  async lit() {
    const { positionM } = this.bake.light.receivers;
    return { positionM, irradiance: await this.readIndirect() };
  }

  /** Where the picture is looked at from; null for a parallel camera. */
  get viewpoint() {
    return eyeOf(this.#camera);
  }

  #planned(casters, eye, boundsM = this.boundsM) {
    return new ShadowPlan(this.room, casters, boundsM, eye, this.snap);
  }

  /** Writes light that no shadow map has: all bounces are of other light from here on. */
  #writeUnshadowed() {
    const isEmitting = this.light.setUnshadowed(this.#sky, this.#panorama, this.#emitterScale);
    this.#setLooks();
    // Light that nothing sends any more would fade for ever.
    const hasPanorama = this.#panorama !== null && this.#panorama.strength * this.#panorama.panorama.brightest > 0;
    const isDark = this.#casters.length === 0 && isBlack(this.#sky) && !hasPanorama && !isEmitting;
    this.#stale.light ||= isDark;
    this.#begin();
  }

  /** Light has changed: bounces begin anew, from that which there is. */
  #begin() {
    this.#stale.pages = true;
    this.#film.clear();
    this.#bounces = new Bounces();
  }

  /** Draws the shadow maps that changes ask for, and E_dir. */
  #drawShadows() {
    const { lights, direct, cascades } = this.#stale;
    if (!cascades && !direct) return;
    const first = lights ? 0 : this.#plan.firstCascade;
    this.gpu.submit((encoder) => {
      if (cascades) this.shadow.record(encoder, first, this.#plan.faces.length);
      if (lights || direct) this.light.relit(encoder);
    });
    Object.assign(this.#stale, { lights: false, direct: false, cascades: false });
  }
}
