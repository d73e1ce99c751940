// Radiance that reaches the camera: Lₑ + ρ/π·(E_dir + E), the sky where nothing is; twin: reference.rs.
// Of glass, alpha is the share of light that it stops: it is drawn over what is behind it.
// `light.wgsl` and `view.wgsl` are joined in front, the former holds group 0. Indirect light E is the kind's: its snippet is joined behind, has
// `fn indirect_irradiance(surface: Surface) -> vec3f` and its bindings in group 1 from 1.

struct ShadeDraw {
    base_colour: vec4f,
    // Emitted radiance times the emitter's scale.
    emissive: vec4f,
    // 2×3 maps from uv to the textures' coordinates.
    base_row0: vec4f,
    base_row1: vec4f,
    emissive_row0: vec4f,
    emissive_row1: vec4f,
    transmission_row0: vec4f,
    transmission_row1: vec4f,
    // Alpha below it is not drawn.
    cutoff: f32,
    // Number of the draw.
    index: u32,
    // Share of light that passes what is there.
    transmission: f32,
    // 1 where alpha is the share that is there.
    blends: f32,
}

// A point that the camera sees.
struct Surface {
    // Metres.
    position: vec3f,
    // Shading normal on the seen side.
    normal: vec3f,
    // The triangle's own normal on the seen side.
    facet: vec3f,
    draw: u32,
    front: bool,
    // Lightmap coordinates in texels of the side's block.
    lightmap_texel: vec2f,
}

@group(1) @binding(0) var<uniform> view: ShadeView;
@group(2) @binding(0) var<uniform> draw: ShadeDraw;
@group(3) @binding(0) var base_colour: texture_2d<f32>;
@group(3) @binding(1) var base_sampler: sampler;
@group(3) @binding(2) var emissive: texture_2d<f32>;
@group(3) @binding(3) var emissive_sampler: sampler;
@group(3) @binding(4) var transmission: texture_2d<f32>;
@group(3) @binding(5) var transmission_sampler: sampler;

const PI = 3.14159265358979;
// Pixels by which shadows are looked up nearer to the eye.
const BEFORE_PIXELS = 1.0;

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

// A point before one that is seen. Nothing is between, so that it lies on the seen side of every edge that rounding puts the
// point behind, as a floor's at a wall's foot.
fn before(position: vec3f) -> vec3f {
    let clip = view.clip_from_world * vec4f(position, 1.0);
    let ndc = clip.xy / clip.w;
    let ray = view.ray.xyz + view.ray_per_x.xyz * ndc.x + view.ray_per_y.xyz * ndc.y;
    return position - ray * (BEFORE_PIXELS * view.ray_per_y.w * clip.w);
}

@fragment
fn shade(corner: Corner, @builtin(front_facing) front: bool) -> @location(0) vec4f {
    let base_uv = mapped(draw.base_row0, draw.base_row1, corner.uv);
    let emissive_uv = mapped(draw.emissive_row0, draw.emissive_row1, corner.uv);
    let across = cross(dpdx(corner.position), dpdy(corner.position));
    let colour = draw.base_colour * corner.colour * textureSample(base_colour, base_sampler, base_uv);
    let glow = draw.emissive.rgb * textureSample(emissive, emissive_sampler, emissive_uv).rgb;
    let transmission_uv = mapped(draw.transmission_row0, draw.transmission_row1, corner.uv);
    let passing = draw.transmission * textureSample(transmission, transmission_sampler, transmission_uv).a;
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
    let surface = Surface(corner.position, normal, facet, draw.index, front, corner.lightmap_texel);
    let met = stopped(mix(1.0, colour.a, draw.blends), colour.rgb, passing);
    if view.horizon.w == 1.0 {
        return vec4f(indirect_irradiance(surface), met.share);
    }
    let rho = clamp(met.albedo, vec3f(0.0), vec3f(1.0));
    let e_dir = seen_irradiance(surface.position, before(surface.position), surface.normal, surface.facet);
    return vec4f(glow + rho * (1.0 / PI) * (e_dir + indirect_irradiance(surface)), met.share);
}

@fragment
fn sky(corner: SkyCorner) -> @location(0) vec4f {
    return vec4f(gradient(normalize(corner.ray)), 0.0);
}
