// How much light a thin surface stops that lets some of it straight through; twin: `stopped` in proto's glass.rs.
// Without branches, here and where it is called: with them lavapipe of Mesa 22 crashed in the shading pass.

struct Stopped {
    // Diffuse albedo that the stopped light meets.
    albedo: vec3f,
    // Share that does not pass straight through.
    share: f32,
}

fn stopped(alpha: f32, base_colour: vec3f, transmission: f32) -> Stopped {
    let colour = clamp(base_colour, vec3f(0.0), vec3f(1.0));
    let left = 1.0 - transmission * min(dot(colour, vec3f(0.2126, 0.7152, 0.0722)), 1.0);
    return Stopped(colour * ((1.0 - transmission) / max(left, 1.1754944e-38)), clamp(alpha, 0.0, 1.0) * left);
}
