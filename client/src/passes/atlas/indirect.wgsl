// Indirect light of kinds whose light is all in the lightmap. Joined behind `lightmap.wgsl`.

fn indirect_irradiance(surface: Surface) -> vec3f {
    return from_lightmap(surface);
}
