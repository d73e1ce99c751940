// Where walks of a picture's pixels start (passes/walk); joined behind `shade.wgsl`.

struct Start {
    // Metres, then slopes' width.
    @location(0) point: vec4f,
    // Shading normal and facet.
    @location(1) normals: vec2u,
}

// Where walks of a pixel start.
@fragment
fn start(corner: Corner, @builtin(front_facing) front: bool) -> Start {
    let met = met_at(corner, front);
    let normals = vec2u(octahedral_code(met.surface.towards), octahedral_code(met.surface.facet));
    return Start(vec4f(met.surface.position, met.gloss.alpha), normals);
}
