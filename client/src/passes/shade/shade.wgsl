// Radiance that reaches the camera: Lₑ + ρ/π·(E_dir + E_atlas), the sky where nothing is; twin: reference.rs.
// `light.wgsl` is joined in front and holds group 0.

struct ShadeView {
    clip_from_world: mat4x4f,
    // Radiance straight up and at the horizon.
    zenith: vec4f,
    horizon: vec4f,
    // Rays of the picture's corners, for the sky: world directions at ndc (−1, −1), and per unit of ndc x and y.
    ray: vec4f,
    ray_per_x: vec4f,
    ray_per_y: vec4f,
}

struct ShadeDraw {
    base_colour: vec4f,
    // Emitted radiance times the emitter's scale.
    emissive: vec4f,
    // 2×3 maps from uv to the textures' coordinates.
    base_row0: vec4f,
    base_row1: vec4f,
    emissive_row0: vec4f,
    emissive_row1: vec4f,
    // Block of the front and of the back: page, origin; width 0 when there is none.
    front: vec4u,
    front_size: vec4u,
    back: vec4u,
    back_size: vec4u,
    // Alpha below it is not drawn.
    cutoff: f32,
    pad0: f32,
    pad1: f32,
    pad2: f32,
}

@group(1) @binding(0) var<uniform> view: ShadeView;
@group(1) @binding(1) var atlas: texture_2d_array<f32>;
@group(2) @binding(0) var<uniform> draw: ShadeDraw;
@group(3) @binding(0) var base_colour: texture_2d<f32>;
@group(3) @binding(1) var base_sampler: sampler;
@group(3) @binding(2) var emissive: texture_2d<f32>;
@group(3) @binding(3) var emissive_sampler: sampler;

const PI = 3.14159265358979;

struct Vertex {
    @location(0) position: vec3f,
    @location(1) normal: vec3f,
    @location(2) uv: vec2f,
    @location(3) colour: vec4f,
    @location(4) lightmap_texel: vec2f,
}

struct Corner {
    @builtin(position) clip: vec4f,
    @location(0) position: vec3f,
    @location(1) normal: vec3f,
    @location(2) uv: vec2f,
    @location(3) colour: vec4f,
    @location(4) lightmap_texel: vec2f,
}

@vertex
fn corner(vertex: Vertex) -> Corner {
    let clip = view.clip_from_world * vec4f(vertex.position, 1.0);
    return Corner(clip, vertex.position, vertex.normal, vertex.uv, vertex.colour, vertex.lightmap_texel);
}

fn mapped(row0: vec4f, row1: vec4f, uv: vec2f) -> vec2f {
    return vec2f(dot(row0.xyz, vec3f(uv, 1.0)), dot(row1.xyz, vec3f(uv, 1.0)));
}

// Whether no wall stands between two taps that are receivers; each link is a bit of the earlier tap.
fn linked(first_kind: f32, second_kind: f32, first: u32, second: u32) -> bool {
    if first_kind <= 0.0 || second_kind <= 0.0 {
        return false;
    }
    var bit = 3u;
    if first == 0u && second == 3u {
        bit = 2u;
    } else if second - first == 2u {
        bit = 1u;
    } else if first != 1u {
        bit = 0u;
    }
    return (((u32(first_kind) - 1u) >> bit) & 1u) == 1u;
}

// Bilinear over the receivers that no wall parts from the nearest one; over filled texels where there is no receiver.
fn atlas_irradiance(block: vec4u, size: vec4u, texel: vec2f) -> vec3f {
    if size.x == 0u {
        return vec3f(0.0);
    }
    let at = texel - 0.5;
    let base = floor(at);
    let share = at - base;
    let last = vec2f(size.xy) - 1.0;
    var taps: array<vec4f, 4>;
    var weights: array<f32, 4>;
    var home = 4u;
    for (var tap = 0u; tap < 4u; tap++) {
        let step = vec2f(f32(tap & 1u), f32(tap >> 1u));
        let inside = vec2u(clamp(base + step, vec2f(0.0), last));
        let weight = mix(1.0 - share, share, step);
        // Never quite 0, so that a lone receiver counts wherever it lies.
        weights[tap] = weight.x * weight.y + 1e-6;
        taps[tap] = textureLoad(atlas, block.yz + inside, i32(block.x), 0);
        if taps[tap].w > 0.0 && (home == 4u || weights[tap] > weights[min(home, 3u)]) {
            home = tap;
        }
    }
    var sum = vec3f(0.0);
    var total = 0.0;
    for (var tap = 0u; tap < 4u; tap++) {
        var counts = taps[tap].w < 0.0;
        if home < 4u {
            let first = min(home, tap);
            let second = max(home, tap);
            counts = tap == home || linked(taps[first].w, taps[second].w, first, second);
        }
        if counts {
            sum += weights[tap] * taps[tap].rgb;
            total += weights[tap];
        }
    }
    return select(vec3f(0.0), sum / max(total, 1e-9), total > 0.0);
}

@fragment
fn shade(corner: Corner, @builtin(front_facing) front: bool) -> @location(0) vec4f {
    let base_uv = mapped(draw.base_row0, draw.base_row1, corner.uv);
    let emissive_uv = mapped(draw.emissive_row0, draw.emissive_row1, corner.uv);
    let across = cross(dpdx(corner.position), dpdy(corner.position));
    let colour = draw.base_colour * corner.colour * textureSample(base_colour, base_sampler, base_uv);
    let glow = draw.emissive.rgb * textureSample(emissive, emissive_sampler, emissive_uv).rgb;
    let alpha = draw.base_colour.a * corner.colour.a * textureSampleLevel(base_colour, base_sampler, base_uv, 0.0).a;
    if alpha < draw.cutoff {
        discard;
    }
    let side = select(-1.0, 1.0, front);
    let normal = side * normalize(corner.normal);
    // dpdx × dpdy points away from or towards the viewer by the adapter's handedness; the normal knows the side.
    let length2 = dot(across, across);
    var facet = select(normal, across * inverseSqrt(max(length2, 1e-38)), length2 > 1e-30);
    facet = select(-facet, facet, dot(facet, normal) >= 0.0);
    var e_atlas: vec3f;
    if front {
        e_atlas = atlas_irradiance(draw.front, draw.front_size, corner.lightmap_texel);
    } else {
        e_atlas = atlas_irradiance(draw.back, draw.back_size, corner.lightmap_texel);
    }
    let rho = clamp(colour.rgb, vec3f(0.0), vec3f(1.0));
    let e = direct_irradiance(corner.position, normal, facet) + e_atlas;
    return vec4f(glow + rho * (1.0 / PI) * e, 1.0);
}

struct SkyCorner {
    @builtin(position) clip: vec4f,
    @location(0) ray: vec3f,
}

// One triangle over the whole picture at infinite distance.
@vertex
fn sky_corner(@builtin(vertex_index) index: u32) -> SkyCorner {
    let ndc = vec2f(f32(index & 1u), f32(index >> 1u)) * 4.0 - 1.0;
    let ray = view.ray.xyz + view.ray_per_x.xyz * ndc.x + view.ray_per_y.xyz * ndc.y;
    return SkyCorner(vec4f(ndc, 0.0, 1.0), ray);
}

@fragment
fn sky(corner: SkyCorner) -> @location(0) vec4f {
    let share = clamp(normalize(corner.ray).y, 0.0, 1.0);
    return vec4f(mix(view.horizon.rgb, view.zenith.rgb, share), 0.0);
}
