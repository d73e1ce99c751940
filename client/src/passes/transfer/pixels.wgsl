// Irradiance that objects change at pixels, with its bindings; joined behind `volume.wgsl` and `sights.wgsl`, in place of `unmoved.wgsl`.

@group(2) @binding(4) var<storage, read> movers: Movers;
@group(2) @binding(5) var<storage, read> codes: array<u32>;
@group(2) @binding(6) var<storage, read> part_light: array<vec4f>;

// Codes begin with a word for each draw: its object's number from 1, 0 of the bake's own, above its number among the draws of its bake. They are looked
// up, not compared with: some adapters fail where a number of a uniform with a dynamic offset decides how often a loop runs.
const DRAW_BITS = 24u;

fn draw_within(index: u32) -> u32 {
    return codes[index] & ((1u << DRAW_BITS) - 1u);
}

// The object whose surface it is, or none.
var<private> own_object: u32;

// Irradiance that points of emitters give to it.
var<private> given: vec3f;

fn given_about(surface: Surface, normal: vec3f) -> vec3f {
    return given_to(own_object, surface.position, normal, surface.facet);
}

// Finds what objects change at a surface; `moved_by` and `changed` tell it then.
fn find_moved(draw_index: u32, surface: Surface) {
    own_object = (codes[draw_index] >> DRAW_BITS) - 1u;
    find_changes(own_object, surface.position, surface.towards);
    given = given_about(surface, surface.towards);
}

// What a lamp that stands for an object's sight changes, of the share of it that is in sight.
fn moved_by(index: u32, share: f32) -> vec3f {
    if index < light_count.count {
        return vec3f(0.0);
    }
    return changes[index - light_count.count] * share;
}

fn changed(light: vec3f, moved: vec3f) -> vec3f {
    return max(light + moved + given, vec3f(0.0));
}
