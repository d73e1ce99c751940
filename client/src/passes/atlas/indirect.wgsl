// Indirect light of kinds whose light is all in the lightmap. Joined behind `lightmap.wgsl`.

fn indirect_irradiance(surface: Surface) -> Indirect {
    let own = from_lightmap(surface);
    return Indirect(own, own);
}
