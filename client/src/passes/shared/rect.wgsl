// Irradiance from rectangles with shadow maps, and from lamps of all shapes; joined behind `light.wgsl`. Twins: direct/rect.rs, reference.rs.
//
// A rectangle is cut into cells. Each gives its irradiance without occluders in closed form, times the share of its middle
// that arrives by shadow maps: E = L Σ_k F_k V_k, with Σ F_k exact whatever the number of cells.

const RECT_FACES = 5u;
// Diagonals of a cell beyond which it counts as a point, to one part in 10,000; nearer the closed form loses no digits.
const RECT_FAR = 64.0;
const RECT_PI = 3.14159265358979;

// Part of an edge between two points, seen from the origin: θ n·(a × b)/|a × b|, θ being the angle between them.
fn edge_part(a: vec3f, b: vec3f, normal: vec3f) -> f32 {
    let lengths = inverseSqrt(max(vec2f(dot(a, a), dot(b, b)), vec2f(1e-30)));
    let scale = lengths.x * lengths.y;
    // a × (b − a) is a × b without the digits that are lost where both are nearly alike.
    let across = cross(a, b - a) * scale;
    let cosine = dot(a, b) * scale;
    let sine2 = dot(across, across);
    // θ / sin θ by x = sin²(θ/2), within 3 parts in a million: 1 + 2/3 x + 8/15 x² + … as a polynomial; beyond a right angle by π − θ.
    let x = 0.5 * sine2 / (1.0 + abs(cosine));
    let series = 1.0 + x * (0.6663532 + x * (0.5452078 + x * (0.3105367 + x * (1.209364 + x * (-1.711025 + x * 2.584307)))));
    let ratio = select(series, RECT_PI * inverseSqrt(max(sine2, 1e-30)) - series, cosine < 0.0);
    return dot(normal, across) * ratio;
}

// ∫ cosθ dω over a rectangle of half sides u and v before a surface at the origin, above its horizon: Lambert's formula.
fn rect_factor(middle: vec3f, u: vec3f, v: vec3f, normal: vec3f) -> f32 {
    let distance2 = dot(middle, middle);
    if distance2 > RECT_FAR * RECT_FAR * 4.0 * (dot(u, u) + dot(v, v)) {
        let facing = abs(dot(cross(u, v), middle)) * 4.0;
        return max(dot(normal, middle), 0.0) * facing / (distance2 * distance2);
    }
    var corners = array<vec3f, 4>(middle - u - v, middle + u - v, middle + u + v, middle - u + v);
    var sum = 0.0;
    var leaves = vec3f(0.0);
    var enters = vec3f(0.0);
    var is_cut = false;
    for (var i = 0u; i < 4u; i++) {
        var start = corners[i];
        var end = corners[(i + 1u) & 3u];
        let heights = vec2f(dot(start, normal), dot(end, normal));
        if max(heights.x, heights.y) <= 0.0 {
            is_cut = true;
            continue;
        }
        let crossing = mix(start, end, heights.x / (heights.x - heights.y));
        if heights.x <= 0.0 {
            start = crossing;
            enters = crossing;
            is_cut = true;
        }
        if heights.y <= 0.0 {
            end = crossing;
            leaves = crossing;
            is_cut = true;
        }
        sum += edge_part(start, end, normal);
    }
    if is_cut {
        // Along the horizon.
        sum += edge_part(leaves, enters, normal);
    }
    return max(0.5 * sum, 0.0);
}

// Number of the face of half a cube that holds a vector from its middle.
fn half_cube_face(light: Light, d: vec3f) -> u32 {
    let front = light.first_face + RECT_FACES - 1u;
    let across = vec2f(dot(d, faces[front].right), dot(d, faces[front].up));
    return cube_face(vec3f(across, max(dot(d, light.direction), 0.0)));
}

// Irradiance of a lamp in W/m2, and the share of it that arrives, by cascades where it has some. Shadows are those of `before`. Cells of a
// rectangle whose middle lies under the surface's own horizon have the share of the others: no shadow map tells of them. Where that is so
// of all that send light, nobody knows and it is dark: light through a wall would be worse. More points leave less of it.
fn lamp_irradiance(light: Light, position: vec3f, before: vec3f, normal: vec3f, facet: vec3f) -> vec4f {
    let is_rect = light.shape == RECT;
    var arriving = vec3f(0.0);
    var count = 1u;
    var u = vec3f(0.0);
    var v = vec3f(0.0);
    // Half a cube stands before each cell's middle, as six faces around a point.
    var cell = light;
    if is_rect {
        if dot(position - light.position, light.direction) <= 0.0 {
            return vec4f(0.0);
        }
        let front = light.first_face + RECT_FACES - 1u;
        u = faces[front].right * (light.half_size_m.x / f32(light.cells.x));
        v = faces[front].up * (light.half_size_m.y / f32(light.cells.y));
        count = light.cells.x * light.cells.y;
        cell.face_count = RECT_FACES;
        arriving = light.strength;
    } else {
        arriving = unshadowed(light, position, normal);
        if light.shape != SIGHT && max(arriving.x, max(arriving.y, arriving.z)) <= 0.0 {
            return vec4f(0.0);
        }
    }
    var total = 0.0;
    var judged = 0.0;
    var share = 0.0;
    for (var k = 0u; k < count; k++) {
        var factor = 1.0;
        var is_judged = true;
        if is_rect {
            let steps = 2.0 * vec2f(vec2u(k % light.cells.x, k / light.cells.x)) + 1.0 - vec2f(light.cells);
            cell.position = light.position + u * steps.x + v * steps.y;
            cell.first_face = light.first_face + RECT_FACES * k;
            factor = rect_factor(cell.position - position, u, v, normal);
            is_judged = dot(facet, cell.position - before) > 0.0;
        }
        if factor > 0.0 {
            total += factor;
            if is_judged {
                judged += factor;
                share += factor * share_seen(cell, before, facet);
            }
        }
    }
    share /= max(judged, 1e-30);
    return vec4f(arriving * (total * share), share);
}
