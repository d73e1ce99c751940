// A device: buffers within its limits, pipelines, reading back. Everything that is made on it for a frame is made and counted here.

// Smallest buffer: bindings must hold at least one element, and none is larger.
const SMALLEST_BUFFER = 256;
// Most workgroups along one axis of a dispatch.
const GROUPS_MAX = 32768;
/** Threads of a workgroup in the shaders. */
export const THREADS = 64;

/** Stages of shaders as bits of a visibility; `GPUShaderStage` is not everywhere. */
export const VERTEX = 1;
export const FRAGMENT = 2;
export const COMPUTE = 4;

/** Spreads workgroups over two axes: counts along x and y. */
export function groups2d(groups) {
  const x = Math.min(Math.max(groups, 1), GROUPS_MAX);
  return [x, Math.max(Math.ceil(groups / x), 1)];
}

/** Workgroups of so many threads. */
export function groupsFor(threads) {
  return groups2d(Math.ceil(threads / THREADS));
}

/**
 * Hears of a device's errors until the function that it answers is called. That function ends the hearing at once, so that others may
 * be heard in between, and answers the error, null where there was none.
 */
export function errorsOf(device) {
  device.pushErrorScope("out-of-memory");
  device.pushErrorScope("validation");
  return async () => {
    const [invalid, full] = await Promise.all([device.popErrorScope(), device.popErrorScope()]);
    if (full) return new Error(`the device has too little memory for this bake (${full.message})`);
    return invalid && new Error(`the device refuses this bake: ${invalid.message}`);
  };
}

/** A device with the texts of its shaders by name. */
export class Gpu {
  // Shader modules and compute pipelines by name, and how many things were made: shared with branches.
  #shared;
  // Buffers and textures that go with a branch; null for the whole.
  #owned;

  constructor(device, shaders, shared = { modules: new Map(), pipelines: new Map(), created: 0 }, owned = null) {
    this.device = device;
    this.shaders = shaders;
    this.#shared = shared;
    this.#owned = owned;
    // Most bytes of one storage binding; larger arrays are split into pages.
    this.bindingMax = Math.min(device.limits.maxStorageBufferBindingSize, device.limits.maxBufferSize);
  }

  /** The same device, whose buffers and textures that are made by way of the branch can be freed at once. */
  branch() {
    return new Gpu(this.device, this.shaders, this.#shared, new Set());
  }

  /** Frees the buffers and textures of a branch. */
  destroy() {
    this.#owned?.forEach((thing) => thing.destroy());
  }

  /** Frees a buffer or texture before its branch. */
  free(thing) {
    thing?.destroy();
    this.#owned?.delete(thing);
  }

  /** Buffers, textures, samplers, bind groups, shaders and pipelines made so far. */
  get created() {
    return this.#shared.created;
  }

  #kept(thing) {
    this.#owned?.add(thing);
    return this.#made(thing);
  }

  #made(thing) {
    this.#shared.created += 1;
    return thing;
  }

  /** A buffer that can be written. */
  buffer(label, bytes, usage) {
    const size = Math.max(Math.ceil(bytes / 4) * 4, SMALLEST_BUFFER);
    if (size > this.device.limits.maxBufferSize) {
      throw new Error(`${label} takes ${size} bytes, this device has buffers of ${this.device.limits.maxBufferSize}`);
    }
    return this.#kept(this.device.createBuffer({ label, size, usage: usage | GPUBufferUsage.COPY_DST }));
  }

  /** A storage buffer of zeros; larger than one binding is an error. */
  blank(label, bytes) {
    if (bytes > this.bindingMax) {
      throw new Error(`${label} takes ${bytes} bytes, this device binds ${this.bindingMax}: the bake is too large for it`);
    }
    return this.buffer(label, bytes, GPUBufferUsage.STORAGE | GPUBufferUsage.COPY_SRC);
  }

  /** A storage buffer that holds the values of a typed array. */
  storage(label, values) {
    const buffer = this.blank(label, values.byteLength);
    this.write(buffer, values);
    return buffer;
  }

  /** A uniform buffer that holds the values of a typed array. */
  uniform(label, values) {
    const buffer = this.buffer(label, values.byteLength, GPUBufferUsage.UNIFORM);
    this.write(buffer, values);
    return buffer;
  }

  /** A uniform buffer of so many values of so many bytes, one every `stride` bytes, for dynamic offsets. */
  uniforms(label, bytes, count) {
    const alignment = this.device.limits.minUniformBufferOffsetAlignment;
    const stride = Math.ceil(bytes / alignment) * alignment;
    return { buffer: this.buffer(label, stride * Math.max(count, 1), GPUBufferUsage.UNIFORM), stride, bytes };
  }

  /** Overwrites the first values of a buffer of `uniforms`; each is an array buffer or a typed array. */
  writeStrided({ buffer, stride }, values) {
    const all = new Uint8Array(stride * values.length);
    values.forEach((value, index) => all.set(bytesOf(value), stride * index));
    this.write(buffer, all);
  }

  /** Overwrites a buffer from a place on. */
  write(buffer, values, at = 0) {
    if (values.byteLength > 0) {
      this.device.queue.writeBuffer(buffer, at, values);
    }
  }

  /** Runs the commands that `record` records. */
  submit(record) {
    const encoder = this.device.createCommandEncoder();
    record(encoder);
    this.device.queue.submit([encoder.finish()]);
  }

  /** The first bytes of a buffer, after everything submitted has run. */
  async read(buffer, bytes) {
    const landing = this.device.createBuffer({ size: bytes, usage: GPUBufferUsage.MAP_READ | GPUBufferUsage.COPY_DST });
    this.submit((encoder) => encoder.copyBufferToBuffer(buffer, 0, landing, 0, bytes));
    return mapped(landing);
  }

  /** One layer of a texture of so many bytes a texel, row after row. */
  async readLayer(texture, layer, bytesPerTexel) {
    const { width, height } = texture;
    const row = width * bytesPerTexel;
    const padded = Math.ceil(row / 256) * 256;
    const usage = GPUBufferUsage.MAP_READ | GPUBufferUsage.COPY_DST;
    const landing = this.device.createBuffer({ size: padded * height, usage });
    this.submit((encoder) => {
      const layout = { buffer: landing, bytesPerRow: padded, rowsPerImage: height };
      encoder.copyTextureToBuffer({ texture, origin: [0, 0, layer] }, layout, [width, height]);
    });
    const bytes = new Uint8Array(await mapped(landing));
    const rows = new Uint8Array(row * height);
    for (let y = 0; y < height; y++) {
      rows.set(bytes.subarray(padded * y, padded * y + row), row * y);
    }
    return rows.buffer;
  }

  /** A shader module by the name of its text. */
  module(name) {
    let module = this.#shared.modules.get(name);
    if (module === undefined) {
      const code = this.shaders.get(name);
      if (code === undefined) {
        throw new Error(`there is no shader '${name}'`);
      }
      module = this.#made(this.device.createShaderModule({ label: name, code }));
      this.#shared.modules.set(name, module);
    }
    return module;
  }

  /** Whether the adapter is a processor in truth. */
  isProcessor() {
    const described = this.device.adapterInfo;
    return described?.isFallbackAdapter === true || described?.architecture === "swiftshader";
  }

  /** A compute pipeline, made once, with values of overrides; its layout is the shader's unless given. */
  async compute(name, entryPoint, layout = "auto", constants = {}) {
    const key = `${name}/${entryPoint}`;
    let pipeline = this.#shared.pipelines.get(key);
    if (pipeline === undefined) {
      const compute = { module: this.module(name), entryPoint, constants };
      pipeline = await this.device.createComputePipelineAsync({ label: entryPoint, layout, compute });
      this.#shared.pipelines.set(key, this.#made(pipeline));
    }
    return pipeline;
  }

  async render(descriptor) {
    return this.#made(await this.device.createRenderPipelineAsync(descriptor));
  }

  texture(descriptor) {
    return this.#kept(this.device.createTexture(descriptor));
  }

  sampler(descriptor) {
    return this.#made(this.device.createSampler(descriptor));
  }

  /** A bind group with each resource at its own binding: pairs of binding and resource. */
  bindAt(layout, resources) {
    const entries = resources.map(([binding, resource]) => {
      return { binding, resource: resource instanceof GPUBuffer ? { buffer: resource } : resource };
    });
    return this.#made(this.device.createBindGroup({ layout, entries }));
  }

  /** A bind group with resources at bindings 0, 1, …. */
  bind(layout, resources) {
    return this.bindAt(layout, resources.map((resource, binding) => [binding, resource]));
  }

  /** A bind group layout with kinds of binding, each with its visibility, at bindings 0, 1, …. */
  bindLayout(kinds) {
    const entries = kinds.map((kind, binding) => ({ binding, ...kind }));
    return this.#made(this.device.createBindGroupLayout({ entries }));
  }

  pipelineLayout(bindGroupLayouts) {
    return this.#made(this.device.createPipelineLayout({ bindGroupLayouts }));
  }

  /** Splits items of given sizes in bytes into runs, from and to, that each fit into one storage binding. */
  pages(what, bytes) {
    const runs = [];
    let first = 0;
    let sum = 0;
    bytes.forEach((item, index) => {
      if (item > this.bindingMax) {
        throw new Error(`one ${what} takes ${item} bytes, this device binds ${this.bindingMax}`);
      }
      if (sum + item > this.bindingMax) {
        runs.push([first, index]);
        [first, sum] = [index, 0];
      }
      sum += item;
    });
    return bytes.length > first ? [...runs, [first, bytes.length]] : runs;
  }
}

function bytesOf(value) {
  return ArrayBuffer.isView(value)
    ? new Uint8Array(value.buffer, value.byteOffset, value.byteLength)
    : new Uint8Array(value);
}

async function mapped(landing) {
  await landing.mapAsync(GPUMapMode.READ);
  const bytes = landing.getMappedRange().slice(0);
  landing.destroy();
  return bytes;
}

/** Records one dispatch of a compute pass. */
export function dispatch(pass, { pipeline, groups, counts }) {
  pass.setPipeline(pipeline);
  groups.forEach((group, index) => pass.setBindGroup(index, group));
  pass.dispatchWorkgroups(...counts);
}
