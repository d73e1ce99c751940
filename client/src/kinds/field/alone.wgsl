// All surfaces have the light of the field, from a little before them: there is no lightmap. Joined behind `field.wgsl`.

fn indirect_irradiance(surface: Surface) -> Indirect {
    let found = field_at(surface.position + surface.facet * min(0.1 * distance_between_probes_m(), 0.1));
    return Indirect(field_about(found, surface.towards), field_about(found, surface.lobe));
}
