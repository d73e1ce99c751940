// Radiance that reaches the camera: Lₑ + ρ/π·(E_dir + E), with what microfacets reflect, the sky where nothing is; twin: reference.rs.
// Of glass, alpha is the share of light that it stops: it is drawn over what is behind it.
// `light.wgsl` and `view.wgsl` are joined in front, the former holds group 0. Indirect light E is the kind's: its snippet is joined behind, has
// `fn indirect_irradiance(surface: Surface) -> Indirect` and its bindings in group 1 from 1.

// Set where materials of the scene have normal maps, and specular reflection: pipelines of others hold no part of them.
override HAS_MAPS: bool = false;
override HAS_GLOSS: bool = false;

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
    normal_row0: vec4f,
    normal_row1: vec4f,
    specular_row0: vec4f,
    specular_row1: vec4f,
    // Alpha below it is not drawn.
    cutoff: f32,
    // Number of the draw.
    index: u32,
    // Share of light that passes what is there.
    transmission: f32,
    // 1 where alpha is the share that is there.
    blends: f32,
    // Factor on x and y of the normal map's normals.
    normal_scale: f32,
    // 1 where there is a normal map.
    has_normals: f32,
    // Share of metal.
    metallic: f32,
    // Below 0 where all reflection is diffuse.
    roughness: f32,
}

// A point that the camera sees.
struct Surface {
    // Metres.
    position: vec3f,
    // Shading normal on the seen side.
    normal: vec3f,
    // The triangle's own normal on the seen side.
    facet: vec3f,
    // Directions about which light is asked for: the normal that a map says, and the axis of a reflection. Both are `normal` on a surface
    // without either.
    towards: vec3f,
    lobe: vec3f,
    draw: u32,
    front: bool,
    // Lightmap coordinates in texels of the side's block.
    lightmap_texel: vec2f,
    // Those of a place on its seen side: it tells on which side of the texels' edges the point lies.
    lightmap_before: vec2f,
}

// Irradiance that did not come straight from a light, about a surface's `towards` and `lobe` where the kind knows directions.
struct Indirect {
    towards: vec3f,
    lobe: vec3f,
}

@group(1) @binding(0) var<uniform> view: ShadeView;
@group(2) @binding(0) var<uniform> draw: ShadeDraw;
@group(3) @binding(0) var base_colour: texture_2d<f32>;
@group(3) @binding(1) var base_sampler: sampler;
@group(3) @binding(2) var emissive: texture_2d<f32>;
@group(3) @binding(3) var emissive_sampler: sampler;
@group(3) @binding(4) var transmission: texture_2d<f32>;
@group(3) @binding(5) var transmission_sampler: sampler;
@group(3) @binding(6) var normals: texture_2d<f32>;
@group(3) @binding(7) var normals_sampler: sampler;
@group(3) @binding(8) var metallic_roughness: texture_2d<f32>;
@group(3) @binding(9) var metallic_roughness_sampler: sampler;

const PI = 3.14159265358979;
// Pixels by which shadows, and sides of edges, are looked up nearer to the eye.
const BEFORE_PIXELS = 1.0;
// Least square of the sine between a pixel's steps on a surface.
const STEPS_MIN = 1e-6;

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

// A drawn point and its material.
struct Met {
    surface: Surface,
    albedo: vec3f,
    emission: vec3f,
    // Share of light that it stops.
    stopped: f32,
    gloss: Gloss,
}

// Change from a pixel to the next.
struct Step {
    position: vec3f,
    texel: vec2f,
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
    return position - ray_to(clip) * (BEFORE_PIXELS * view.ray_per_y.w * clip.w);
}

// Lightmap coordinates of the point of the surface's plane that is nearest to `before`: it lies on the seen side of a texel's edge too,
// which is rounded, as a floor's at a wall's foot. Steps are those of the screen's pixels.
fn texel_before(corner: Corner, step_x: Step, step_y: Step) -> vec2f {
    let ahead = before(corner.position) - corner.position;
    let squares = vec3f(dot(step_x.position, step_x.position), dot(step_x.position, step_y.position), dot(step_y.position, step_y.position));
    let along = vec2f(dot(ahead, step_x.position), dot(ahead, step_y.position));
    let area2 = squares.x * squares.z - squares.y * squares.y;
    // Seen from its edge.
    if !(area2 > STEPS_MIN * squares.x * squares.z) {
        return corner.lightmap_texel;
    }
    let steps = vec2f(squares.z * along.x - squares.y * along.y, squares.x * along.y - squares.y * along.x) / area2;
    return corner.lightmap_texel + steps.x * step_x.texel + steps.y * step_y.texel;
}

// The point that is drawn of a corner, if any.
fn met_at(corner: Corner, front: bool) -> Met {
    let base_uv = mapped(draw.base_row0, draw.base_row1, corner.uv);
    let emissive_uv = mapped(draw.emissive_row0, draw.emissive_row1, corner.uv);
    let step_x = Step(dpdx(corner.position), dpdx(corner.lightmap_texel));
    let step_y = Step(dpdy(corner.position), dpdy(corner.lightmap_texel));
    let across = cross(step_x.position, step_y.position);
    let colour = draw.base_colour * corner.colour * textureSample(base_colour, base_sampler, base_uv);
    let glow = draw.emissive.rgb * textureSample(emissive, emissive_sampler, emissive_uv).rgb;
    let transmission_uv = mapped(draw.transmission_row0, draw.transmission_row1, corner.uv);
    let passing = draw.transmission * textureSample(transmission, transmission_sampler, transmission_uv).a;
    let unit = normalize(corner.normal);
    var bent = unit;
    if HAS_MAPS {
        let uv = mapped(draw.normal_row0, draw.normal_row1, corner.uv);
        let uv_x = dpdx(uv);
        let uv_y = dpdy(uv);
        let texel = 2.0 * textureSample(normals, normals_sampler, uv).xyz - 1.0;
        if draw.has_normals == 1.0 && view.ray.w != 1.0 && view.horizon.w != 1.0 {
            bent = mapped_normal(unit, step_x.position, step_y.position, uv_x, uv_y, draw.normal_scale * texel.xy, texel.z);
        }
    }
    var metallic = draw.metallic;
    var roughness = -1.0;
    if HAS_GLOSS {
        let uv = mapped(draw.specular_row0, draw.specular_row1, corner.uv);
        let texel = textureSample(metallic_roughness, metallic_roughness_sampler, uv);
        metallic *= texel.b;
        roughness = select(draw.roughness * texel.g, -1.0, draw.roughness < 0.0 || view.zenith.w == 1.0);
    }
    let alpha = draw.base_colour.a * corner.colour.a * textureSampleLevel(base_colour, base_sampler, base_uv, 0.0).a;
    if alpha < draw.cutoff {
        discard;
    }
    let side = select(-1.0, 1.0, front);
    let normal = side * unit;
    let towards = side * bent;
    // dpdx × dpdy points away from or towards the viewer by the adapter's handedness; the normal knows the side.
    let length2 = dot(across, across);
    var facet = select(normal, across * inverseSqrt(max(length2, 1e-38)), length2 > 1e-30);
    facet = select(-facet, facet, dot(facet, normal) >= 0.0);
    let met = stopped(mix(1.0, colour.a, draw.blends), colour.rgb, passing);
    let rho = clamp(met.albedo, vec3f(0.0), vec3f(1.0));
    let eye = -normalize(ray_to(view.clip_from_world * vec4f(corner.position, 1.0)));
    let gloss = gloss_of(rho, metallic, roughness, towards, eye);
    let texel = corner.lightmap_texel;
    let lightmap_before = texel_before(corner, step_x, step_y);
    let surface = Surface(corner.position, normal, facet, towards, gloss.lobe, draw_within(draw.index), front, texel, lightmap_before);
    return Met(surface, rho, glow, met.share, gloss);
}

@fragment
fn shade(corner: Corner, @builtin(front_facing) front: bool) -> @location(0) vec4f {
    let met = met_at(corner, front);
    let surface = met.surface;
    let gloss = met.gloss;
    let indirect = indirect_irradiance(surface);
    if view.horizon.w == 1.0 {
        return vec4f(indirect.towards, met.stopped);
    }
    find_moved(draw.index, surface);
    let seen = seen_light(surface, before(surface.position), gloss);
    var diffuse = changed(indirect.towards, seen.moved);
    var reflected = gloss.reflectance * (1.0 / PI) * (indirect.lobe + given_about(surface, surface.lobe));
    let parts = u32(view.ray_per_x.w);
    // Walks are of what is behind glass.
    if (parts & 7u) != 0u && draw.transmission == 0.0 && draw.blends == 0.0 {
        let clip = view.clip_from_world * vec4f(surface.position, 1.0);
        let own = walked_at(corner.clip.xy, parts >> 3u, surface, WALKED_PIXELS * view.ray_per_y.w * clip.w);
        if own.weight > 0.0 {
            diffuse = select(diffuse, own.irradiance, (parts & 4u) != 0u);
            if (parts & 2u) != 0u {
                diffuse *= own.open;
                reflected *= own.open;
            }
            reflected = select(reflected, gloss.reflectance * own.reflected, (parts & 1u) != 0u && own.reflects);
        }
    }
    var radiance = met.emission + met.albedo * gloss.diffuse * (1.0 / PI) * (seen.irradiance + diffuse);
    if HAS_GLOSS {
        radiance += seen.reflected + reflected;
    }
    return vec4f(radiance, met.stopped);
}

@fragment
fn sky(corner: SkyCorner) -> @location(0) vec4f {
    return vec4f(gradient(normalize(corner.ray)), 0.0);
}
