// Surfaces with a lightmap have its light, all else that of the field. Joined behind `lightmap.wgsl` and `field.wgsl`.

// Light about another direction than a surface's normal, of that about its normal, at most.
const TURNED_MOST = 4.0;

// A lightmap knows light about normals alone: about another direction there is as much more as the field has.
fn turned(own: vec3f, about_normal: vec3f, about: vec3f) -> vec3f {
    let share = min(about / max(about_normal, vec3f(1e-30)), vec3f(TURNED_MOST));
    return own * select(share, vec3f(1.0), about_normal + about <= vec3f(0.0));
}

fn indirect_irradiance(surface: Surface) -> Indirect {
    let placement = placements[surface.draw];
    let has_lightmap = placement.front_size.x != 0u || placement.back_size.x != 0u;
    var own = vec3f(0.0);
    var at = surface.position;
    if has_lightmap {
        own = from_lightmap(surface);
        let is_turned = (HAS_MAPS && any(surface.towards != surface.normal)) || (HAS_GLOSS && any(surface.lobe != surface.normal));
        if !is_turned {
            return Indirect(own, own);
        }
        // Before the surface, so that probes see it.
        at += surface.facet * min(0.1 * distance_between_probes_m(), 0.1);
    }
    let found = field_at(at);
    let about = Indirect(field_about(found, surface.towards), field_about(found, surface.lobe));
    if !has_lightmap {
        return about;
    }
    let about_normal = field_about(found, surface.normal);
    return Indirect(turned(own, about_normal, about.towards), turned(own, about_normal, about.lobe));
}
