// All surfaces have the light of the field: there is no lightmap. Joined behind `field.wgsl`.

fn indirect_irradiance(surface: Surface) -> vec3f {
    return field_irradiance(surface.position, surface.normal);
}
