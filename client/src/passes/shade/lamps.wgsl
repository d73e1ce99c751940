// Light straight from lamps at a point that is seen; twin: lamps.rs.

struct Seen {
    // Irradiance on the mapped normal in W/m2.
    irradiance: vec3f,
    // Radiance that microfacets reflect of it towards the eye, in W/m2/sr.
    reflected: vec3f,
    // Indirect irradiance that objects give and take.
    moved: vec3f,
}

// Irradiance on a mapped normal, of that on the surface's own, at most: none comes from behind.
const BENT_MOST = 8.0;

// Towards the point of a rectangle that is nearest to the mirrored ray, or to its middle.
fn towards_rect(light: Light, position: vec3f, mirrored: vec3f) -> vec3f {
    let front = light.first_face + RECT_FACES - 1u;
    let middle = light.position - position;
    let facing = dot(mirrored, light.direction);
    let far = dot(middle, light.direction) / min(facing, -1e-4);
    let beside = mirrored * far - middle;
    let across = vec2f(dot(beside, faces[front].right), dot(beside, faces[front].up));
    let within = select(vec2f(0.0), clamp(across, -light.half_size_m, light.half_size_m), facing < -1e-4);
    return normalize(middle + faces[front].right * within.x + faces[front].up * within.y);
}

fn towards_light(light: Light, position: vec3f, mirrored: vec3f) -> vec3f {
    if light.shape == RECT {
        return towards_rect(light, position, mirrored);
    }
    let away = light.position - position;
    return select(away * inverseSqrt(max(dot(away, away), 1e-30)), -light.direction, light.shape == SUN);
}

// Irradiance of a lamp without shadows.
fn free_irradiance(light: Light, position: vec3f, normal: vec3f) -> vec3f {
    if light.shape != RECT {
        return unshadowed(light, position, normal);
    }
    let front = light.first_face + RECT_FACES - 1u;
    let u = faces[front].right * light.half_size_m.x;
    let v = faces[front].up * light.half_size_m.y;
    return light.strength * rect_factor(light.position - position, u, v, normal);
}

// Light of all lamps, by cascades where there are some. Shadows are those of `before`, a point a little nearer to the eye.
fn seen_light(surface: Surface, before: vec3f, gloss: Gloss) -> Seen {
    var seen = Seen(vec3f(0.0), vec3f(0.0), vec3f(0.0));
    let normal = surface.towards;
    let is_bent = HAS_MAPS && any(normal != surface.normal);
    let mirrored = reflect(-gloss.eye, normal);
    for (var index = 0u; index < lamp_count(); index++) {
        let light = lamp_at(index);
        let found = lamp_irradiance(light, surface.position, before, normal, surface.facet);
        seen.moved += moved_by(index, found.w);
        var arriving = found.rgb;
        if is_bent {
            arriving = min(arriving, BENT_MOST * found.w * free_irradiance(light, surface.position, surface.normal));
        }
        seen.irradiance += arriving;
        if HAS_GLOSS && gloss.alpha > 0.0 && max(arriving.x, max(arriving.y, arriving.z)) > 0.0 {
            var solid = 0.0;
            if light.shape == RECT {
                let strength = max(light.strength.x, max(light.strength.y, light.strength.z));
                solid = max(found.x, max(found.y, found.z)) / max(4.0 * PI * strength * found.w, 1e-30);
            }
            seen.reflected += arriving * microfacets(gloss, normal, towards_light(light, surface.position, mirrored), solid);
        }
    }
    return seen;
}
