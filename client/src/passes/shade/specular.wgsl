// Specular reflection by microfacets (METHOD.md §2.15); twin: specular.rs.

// How a point reflects.
struct Gloss {
    // Share of the light that is left for diffuse reflection.
    diffuse: f32,
    // Width of the microfacets' slopes; 0 where all reflection is diffuse.
    alpha: f32,
    // Reflectance along the normal.
    f0: vec3f,
    // Factor for light that microfacets pass on among themselves.
    gain: vec3f,
    // Share of even light that is reflected.
    reflectance: vec3f,
    // Towards the eye.
    eye: vec3f,
    // Axis about which light is gathered.
    lobe: vec3f,
}

// Reflectance of dielectrics along the normal.
const DIELECTRIC = 0.04;
// Least roughness, and least cosine to the eye.
const ROUGHNESS_MIN = 0.1;
const EYE_MIN = 0.05;

fn quartic(r: f32, c: f32, r0: array<f32, 5>, r1: array<f32, 4>, r2: array<f32, 3>, r3: array<f32, 2>, r4: f32) -> f32 {
    let of_r0 = r0[0] + c * (r0[1] + c * (r0[2] + c * (r0[3] + c * r0[4])));
    let of_r1 = r1[0] + c * (r1[1] + c * (r1[2] + c * r1[3]));
    let of_r2 = r2[0] + c * (r2[1] + c * r2[2]);
    return of_r0 + r * (of_r1 + r * (of_r2 + r * (r3[0] + c * r3[1] + r * r4)));
}

// Share of even light that microfacets which reflect all reflect at once, by roughness and cosine to the eye; and the part of it in
// (1 - h.v)^5.
fn even_albedo(r: f32, c: f32) -> vec2f {
    let all = quartic(
        r, c,
        array<f32, 5>(1.0271, 0.2284, -0.0095, -0.9731, 0.6167), array<f32, 4>(-0.9966, -0.1048, 3.3627, -1.2791),
        array<f32, 3>(2.8099, -4.1626, -0.3271), array<f32, 2>(-2.8592, 1.9951), 0.9722,
    );
    let grazing = quartic(
        r, c,
        array<f32, 5>(1.035, -3.7387, 4.0641, -1.3103, -0.055), array<f32, 4>(-2.0838, 7.8941, -7.3108, 1.7221),
        array<f32, 3>(0.4977, -4.3892, 2.8402), array<f32, 2>(1.1694, 0.2727), -0.5884,
    );
    let whole = clamp(all, 0.2, 1.0);
    return vec2f(whole, clamp(grazing, 0.0, whole));
}

// Reflection of a point seen from `eye`; diffuse alone where roughness is below 0.
fn gloss_of(albedo: vec3f, metallic: f32, roughness: f32, normal: vec3f, eye: vec3f) -> Gloss {
    if roughness < 0.0 {
        return Gloss(1.0, 0.0, vec3f(0.0), vec3f(0.0), vec3f(0.0), eye, normal);
    }
    let rough = clamp(roughness, ROUGHNESS_MIN, 1.0);
    let alpha = rough * rough;
    let metal = clamp(metallic, 0.0, 1.0);
    let f0 = mix(vec3f(DIELECTRIC), albedo, metal);
    let once = even_albedo(rough, clamp(dot(normal, eye), EYE_MIN, 1.0));
    let lost = (1.0 - once.x) / once.x;
    let of_dielectric = (DIELECTRIC * (once.x - once.y) + once.y) * (1.0 + DIELECTRIC * lost);
    let gain = 1.0 + f0 * lost;
    let of_metal = (albedo * (once.x - once.y) + once.y) * (1.0 + albedo * lost);
    let reflectance = mix(vec3f(of_dielectric), of_metal, metal);
    // Wide lobes lean to the normal.
    let mirrored = reflect(-eye, normal);
    let lobe = normalize(mix(normal, mirrored, (1.0 - alpha) * (sqrt(1.0 - alpha) + alpha)));
    return Gloss((1.0 - metal) * (1.0 - of_dielectric), alpha, f0, gain, reflectance, eye, lobe);
}

// Radiance reflected towards the eye of light from a direction, over its irradiance. `solid` is the cosine-weighted solid angle that
// the light spans, over 4 pi: its lobe is as much wider.
fn microfacets(gloss: Gloss, normal: vec3f, towards: vec3f, solid: f32) -> vec3f {
    let a2 = min(gloss.alpha * gloss.alpha + solid, 1.0);
    let middle = normalize(gloss.eye + towards);
    let to_eye = clamp(dot(normal, gloss.eye), EYE_MIN, 1.0);
    let to_light = clamp(dot(normal, towards), 1e-3, 1.0);
    let to_middle = clamp(dot(normal, middle), 0.0, 1.0);
    let spread = to_middle * to_middle * (a2 - 1.0) + 1.0;
    let slopes = a2 / (PI * spread * spread);
    let shading = to_light * sqrt(to_eye * to_eye * (1.0 - a2) + a2) + to_eye * sqrt(to_light * to_light * (1.0 - a2) + a2);
    let grazing = 1.0 - clamp(dot(gloss.eye, middle), 0.0, 1.0);
    let squared = grazing * grazing;
    let fresnel = gloss.f0 + (1.0 - gloss.f0) * (squared * squared * grazing);
    return fresnel * gloss.gain * (0.5 * slopes / shading);
}
