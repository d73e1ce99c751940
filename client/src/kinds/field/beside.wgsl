// Surfaces with a lightmap have its light, all else that of the field. Joined behind `lightmap.wgsl` and `field.wgsl`.

fn indirect_irradiance(surface: Surface) -> vec3f {
    let placement = placements[surface.draw];
    if placement.front_size.x == 0u && placement.back_size.x == 0u {
        return field_irradiance(surface.position, surface.normal);
    }
    return from_lightmap(surface);
}
