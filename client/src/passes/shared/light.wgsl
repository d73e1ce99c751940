// Irradiance from lights with shadow maps; joined in front of the passes that need it.
// `rect.wgsl` and `shadow_map.wgsl` are joined behind. Twin: direct/reference.rs. Depth is reversed: the greater, the nearer to the light.

struct Light {
    // Metres; for a sun the centre of its box, for a rectangle its own.
    position: vec3f,
    // Cut-off distance in metres, 0 for none.
    range_m: f32,
    direction: vec3f,
    // 0 point, 1 spot, 2 sun, 3 rectangle, 4 what an object sees.
    shape: u32,
    // W/sr; W/m2 for a sun; W/m2/sr for a rectangle.
    strength: vec3f,
    first_face: u32,
    cone_cos_inner: f32,
    cone_cos_outer: f32,
    // Faces: 1 or 6 for points and spots, tiles² for a sun, 5 for each cell of a rectangle.
    face_count: u32,
    // Half side of a sun's box in metres.
    half_extent: f32,
    // Faces of a sun about the eye, from the widest to the narrowest.
    first_cascade: u32,
    cascades: u32,
    // Half width and height of a rectangle in metres.
    half_size_m: vec2f,
    // Columns and rows of a rectangle's cells.
    cells: vec2u,
    pad: vec2u,
}

struct Face {
    clip_from_world: mat4x4f,
    right: vec3f,
    // Side of a shadow texel in metres where clip w is 1.
    texel_at_unit_w: f32,
    up: vec3f,
    // 1 where the maps of glass hold anything.
    panes: f32,
}

struct LightCount {
    count: u32,
    // Texels along a face's side.
    side: u32,
    // Constant offset along the normal in metres.
    bias_m: f32,
    // Texels by which depth may lie aside, as adapters move corners.
    snap: f32,
}

const POINT = 0u;
const SPOT = 1u;
const SUN = 2u;
const RECT = 3u;
// Sight of an object: no light, whose share tells what is in sight.
const SIGHT = 4u;
// Texels at a cascade's rim that the filter's reach may leave, and the part of its half side within which it fades in.
const CASCADE_GUARD = 8.0;
const CASCADE_RIM = 0.1;

@group(0) @binding(0) var<storage, read> lights: array<Light>;
@group(0) @binding(1) var<storage, read> faces: array<Face>;
@group(0) @binding(2) var<uniform> light_count: LightCount;
@group(0) @binding(3) var shadow_maps: texture_depth_2d_array;
// Depth of the glass nearest to the light, and the share of light that passes all of it before the next opaque surface.
@group(0) @binding(4) var pane_maps: texture_depth_2d_array;
@group(0) @binding(5) var passed_maps: texture_2d_array<f32>;

fn cube_face(d: vec3f) -> u32 {
    let a = abs(d);
    if a.x >= a.y && a.x >= a.z {
        return select(1u, 0u, d.x >= 0.0);
    }
    if a.y >= a.z {
        return select(3u, 2u, d.y >= 0.0);
    }
    return select(5u, 4u, d.z >= 0.0);
}

fn face_of(light: Light, position: vec3f) -> u32 {
    let d = position - light.position;
    if light.shape == SUN {
        let tiles = u32(round(sqrt(f32(light.face_count))));
        let first = light.first_face;
        let across = vec2f(dot(d, faces[first].right), dot(d, faces[first].up)) / light.half_extent;
        let tile = clamp((0.5 * across + 0.5) * f32(tiles), vec2f(0.0), vec2f(f32(tiles) - 0.5));
        return first + u32(tile.y) * tiles + u32(tile.x);
    }
    if light.shape == RECT {
        return light.first_face + half_cube_face(light, d);
    }
    if light.face_count == 6u {
        return light.first_face + cube_face(d);
    }
    return light.first_face;
}

// Irradiance in W/m2 that would arrive without occluders on a surface with this normal; not of rectangles.
fn unshadowed(light: Light, position: vec3f, normal: vec3f) -> vec3f {
    if light.shape == SUN {
        return light.strength * max(dot(normal, -light.direction), 0.0);
    }
    let d = light.position - position;
    let distance2 = max(dot(d, d), 1e-30);
    let towards = d * inverseSqrt(distance2);
    var factor = max(dot(normal, towards), 0.0) / distance2;
    if light.range_m > 0.0 {
        let share2 = distance2 / (light.range_m * light.range_m);
        factor *= clamp(1.0 - share2 * share2, 0.0, 1.0);
    }
    if light.shape == SPOT {
        let cosine = dot(light.direction, -towards);
        let cone = clamp((cosine - light.cone_cos_outer) / (light.cone_cos_inner - light.cone_cos_outer), 0.0, 1.0);
        factor *= cone * cone;
    }
    return light.strength * factor;
}

// A point lies beyond the box that a sun's maps are of: far from the core of its scene.
fn is_beyond(light: Light, position: vec3f) -> bool {
    if light.shape != SUN {
        return false;
    }
    let first = light.first_face;
    let d = position - light.position;
    let across = max(abs(dot(d, faces[first].right)), abs(dot(d, faces[first].up)));
    let depth = (faces[first].clip_from_world * vec4f(position, 1.0)).z;
    return across > light.half_extent || depth < 0.0 || depth > 1.0;
}

// Share of a light that arrives by one of its faces.
fn share_by(face: u32, light: Light, position: vec3f, facet: vec3f) -> f32 {
    if is_beyond(light, position) {
        return 1.0;
    }
    var read = face;
    var at = lifted(face, position, facet);
    if face < light.first_face + light.face_count {
        // The lift may lead into the next face, to which the same surface has another slope.
        read = face_of(light, at);
        at = lifted(read, position, facet);
    }
    let share = visibility(read, at);
    if share <= 0.0 || is_behind(face, light, position, facet, distance(at, position)) {
        return 0.0;
    }
    return share;
}

// Share of a light that arrives: by the narrowest cascade that holds the point, fading in at its rim. `share_by` is called here alone:
// adapters compile a copy of it for each call.
fn share_seen(light: Light, position: vec3f, facet: vec3f) -> f32 {
    var cascade = light.cascades;
    var own = 1.0;
    for (; cascade > 0u; cascade--) {
        let ndc = (faces[light.first_cascade + cascade - 1u].clip_from_world * vec4f(position, 1.0)).xy;
        let inside = 1.0 - max(abs(ndc.x), abs(ndc.y)) - 2.0 * CASCADE_GUARD / f32(light_count.side);
        if inside > 0.0 {
            own = min(inside / CASCADE_RIM, 1.0);
            break;
        }
    }
    var share = 0.0;
    for (var wider = 0u; wider < select(1u, 2u, own < 1.0); wider++) {
        var face = light.first_cascade + cascade - 1u - wider;
        if cascade == wider {
            face = face_of(light, position);
        }
        share += select(own, 1.0 - own, wider == 1u) * share_by(face, light, position, facet);
    }
    return share;
}

// Irradiance of one light in W/m2, and the share of it that arrives, whatever is seen. `normal` is the shading normal, `facet`
// the surface's own.
fn light_irradiance(seen: Light, position: vec3f, normal: vec3f, facet: vec3f) -> vec4f {
    var light = seen;
    light.cascades = 0u;
    return lamp_irradiance(light, position, position, normal, facet);
}

fn direct_irradiance(position: vec3f, normal: vec3f, facet: vec3f) -> vec3f {
    var sum = vec3f(0.0);
    for (var index = 0u; index < light_count.count; index++) {
        sum += light_irradiance(lights[index], position, normal, facet).rgb;
    }
    return sum;
}
