// Radiance that walks meet; twin: kinds/voxels/light.rs in proto.

// Radiance of the end of a walk along a direction.
fn radiance(hit: Hit, direction: vec3f) -> vec3f {
    let glow = glow_of(hit);
    return reflected(hit, direction) + select(vec3f(0.0), glows[max(glow, 1u) - 1u].rgb, glow != 0u);
}

// Glow of the end of a walk and 1, or 0.
fn glow_of(hit: Hit) -> u32 {
    if hit.element == NOTHING || hit.element == NO_ELEMENT || hit.is_back {
        return 0u;
    }
    return elements[hit.element].marks & GLOW_MARK;
}

// Its radiance but for what it emits.
fn reflected(hit: Hit, direction: vec3f) -> vec3f {
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
    let of_patch = elements[hit.element].patch_number;
    if of_patch == DARK {
        return vec3f(0.0);
    }
    return lambda[of_patch].rgb;
}
