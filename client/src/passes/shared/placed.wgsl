// A bake's own space in that of the lights, which an object's moves; joined with passes that light an object's receivers.

struct Place {
    // Rows of the map.
    rows: array<vec4f, 3>,
}

@group(2) @binding(0) var<uniform> place: Place;

fn placed(own: vec3f) -> vec3f {
    let at = vec4f(own, 1.0);
    return vec3f(dot(place.rows[0], at), dot(place.rows[1], at), dot(place.rows[2], at));
}

fn turned(own: vec3f) -> vec3f {
    return normalize(vec3f(dot(place.rows[0].xyz, own), dot(place.rows[1].xyz, own), dot(place.rows[2].xyz, own)));
}
