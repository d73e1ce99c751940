// Froxels of a medium: columns through squares of pixels, cut into slices that grow with the square root of depth. Joined in front of
// `fog.wgsl` and `over.wgsl`, which bind `fog`. Twin: mod.rs.

struct Fog {
    // Columns, rows and slices; side of a column in pixels.
    size: vec4u,
    // Width and height of the picture in pixels, depth of the last slice's end in metres, height in metres over which the medium thins by a
    // factor of e, or 0.
    picture: vec4f,
    // Eye in metres, at the middle of a parallel camera's picture, and the height above which the medium thins.
    eye: vec4f,
    // Its change per unit of ndc x; then extinction per metre.
    eye_per_x: vec4f,
    // Its change per unit of ndc y; then the share of light that is scattered of what is stopped.
    eye_per_y: vec4f,
    // World direction through the picture's middle, of length 1 along the view; then g of the phase function.
    ray: vec4f,
    ray_per_x: vec4f,
    ray_per_y: vec4f,
    // View depth of a depth d of the picture: (x - d z) / (d w - y).
    by_depth: vec4f,
}

// View depth at a number of slices.
fn depth_of(slices: f32) -> f32 {
    let share = slices / f32(fog.size.z);
    return fog.picture.z * share * share;
}

// Share of light that an optical thickness stops.
fn stopped_by(thickness: f32) -> f32 {
    return select(1.0 - exp(-thickness), thickness * (1.0 - 0.5 * thickness), thickness < 1e-3);
}

fn extinction_at(position: vec3f) -> f32 {
    let above = max(position.y - fog.eye.w, 0.0);
    return fog.eye_per_x.w * select(1.0, exp(-above / max(fog.picture.w, 1e-6)), fog.picture.w > 0.0);
}

fn froxel(column: vec2u, slice: u32) -> u32 {
    return (slice * fog.size.y + column.y) * fog.size.x + column.x;
}
