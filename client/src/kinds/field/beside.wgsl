// Surfaces with a lightmap have its light, all else that of the field. Joined behind `lightmap.wgsl` and `field.wgsl`.

// Light about another direction than a surface's normal, of that about its normal, at most.
const TURNED_MOST = 4.0;

// A lightmap knows light about normals alone: about another direction there is as much more as the field has, before the surface.
fn turned(surface: Surface) -> vec3f {
    let at = surface.position + surface.facet * min(0.1 * distance_between_probes_m(), 0.1);
    var found = array<vec3f, 2>(surface.normal, surface.towards);
    for (var index = 0u; index < 2u; index++) {
        found[index] = field_irradiance(at, found[index]);
    }
    let share = min(found[1] / max(found[0], vec3f(1e-30)), vec3f(TURNED_MOST));
    return select(share, vec3f(1.0), found[0] + found[1] <= vec3f(0.0));
}

fn indirect_irradiance(surface: Surface) -> vec3f {
    let placement = placements[surface.draw];
    if placement.front_size.x == 0u && placement.back_size.x == 0u {
        return field_irradiance(surface.position, surface.towards);
    }
    let own = from_lightmap(surface);
    if all(surface.towards == surface.normal) {
        return own;
    }
    return own * turned(surface);
}
