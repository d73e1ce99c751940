// A panorama behind the scene, on top of the sky's gradient; twin: `Panorama::shown` of proto/src/relight/panorama.rs.
// `view.wgsl` is joined in front.

struct PanoramaNumbers {
    // Cosine and sine of its turn about the vertical.
    turn: vec2f,
    // Factor on its texels.
    strength: f32,
    pad: f32,
}

const PI = 3.14159265358979;

@group(0) @binding(0) var<uniform> view: ShadeView;
@group(0) @binding(1) var<uniform> panorama: PanoramaNumbers;
@group(0) @binding(2) var picture: texture_2d<f32>;

fn pixel(column: i32, row: i32) -> vec3f {
    let size = vec2i(textureDimensions(picture));
    let around = (column + size.x) % size.x;
    return textureLoad(picture, vec2i(around, clamp(row, 0, size.y - 1)), 0).rgb;
}

@fragment
fn panorama_sky(corner: SkyCorner) -> @location(0) vec4f {
    let direction = normalize(corner.ray);
    // Turned back: the picture's own x and z.
    let x = panorama.turn.x * direction.x - panorama.turn.y * direction.z;
    let z = panorama.turn.y * direction.x + panorama.turn.x * direction.z;
    let u = 0.5 + atan2(x, -z) / (2.0 * PI);
    let v = acos(clamp(direction.y, -1.0, 1.0)) / PI;
    let at = vec2f(u, v) * vec2f(textureDimensions(picture)) - 0.5;
    let first = vec2i(floor(at));
    let share = at - floor(at);
    let upper = mix(pixel(first.x, first.y), pixel(first.x + 1, first.y), share.x);
    let lower = mix(pixel(first.x, first.y + 1), pixel(first.x + 1, first.y + 1), share.x);
    return vec4f(gradient(direction) + panorama.strength * mix(upper, lower, share.y), 0.0);
}
