// Radiance that walks meet; twin: kinds/voxels/light.rs in proto.

// Radiance of the end of a walk along a direction.
fn radiance(hit: Hit, direction: vec3f) -> vec3f {
    if hit.element == NOTHING {
        var nearest = 0u;
        var most = -2.0;
        for (var part = 0u; part < voxels.sky_parts; part++) {
            let cosine = dot(direction, glows[voxels.first_direction + part].xyz);
            if cosine > most {
                nearest = part;
                most = cosine;
            }
        }
        return lambda[voxels.first_of_sky + nearest].rgb;
    }
    if hit.is_back || hit.element == NO_ELEMENT {
        return vec3f(0.0);
    }
    let row = elements[hit.element];
    var own = vec3f(0.0);
    if row.patch_number != DARK {
        own = lambda[row.patch_number].rgb;
    }
    let glow = row.marks & GLOW_MARK;
    if glow != 0u {
        own += glows[glow - 1u].rgb;
    }
    return own;
}
