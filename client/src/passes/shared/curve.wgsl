// Curves from radiance to brightness, and sRGB. Twin: picture/tone.rs.

// Curve: 0 none, 1 Reinhard's, 2 filmic.
fn curved(colour: vec3f, curve: u32) -> vec3f {
    if curve == 1u {
        let y = dot(colour, vec3f(0.2126, 0.7152, 0.0722));
        return colour * ((1.0 + y / 16.0) / (1.0 + y));
    }
    if curve == 2u {
        return (colour * (2.51 * colour + 0.03)) / (colour * (2.43 * colour + 0.59) + 0.14);
    }
    return colour;
}

fn srgb(linear: vec3f) -> vec3f {
    let low = 12.92 * linear;
    let high = 1.055 * pow(max(linear, vec3f(0.0031308)), vec3f(1.0 / 2.4)) - 0.055;
    return select(high, low, linear <= vec3f(0.0031308));
}
