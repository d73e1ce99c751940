// Light that a medium scatters towards the eye, summed along the rays of columns of froxels. Joined behind `light.wgsl`, `rect.wgsl`,
// `shadow_map.wgsl`, `numbers.wgsl` and what tells `mean_radiance`. Twin: reference.rs.

@group(1) @binding(0) var<uniform> fog: Fog;
@group(2) @binding(0) var<storage, read_write> froxels: array<vec4f>;

const PI = 3.14159265358979;

// Irradiance of a light on a plane that faces it, W/m2.
fn arriving(light: Light, position: vec3f, towards: vec3f) -> vec3f {
    return lamp_irradiance(light, position, position, towards, towards).rgb;
}

// Henyey and Greenstein's share of scattered light by direction, per steradian.
fn phase(cosine: f32) -> f32 {
    let g = fog.ray.w;
    let below = 1.0 + g * g - 2.0 * g * cosine;
    return (1.0 - g * g) / (4.0 * PI * below * sqrt(below));
}

// Radiance that a thick medium would send along a ray if the light of a point were everywhere.
fn scattered(position: vec3f, ray: vec3f) -> vec3f {
    var sum = mean_radiance(position);
    for (var index = 0u; index < light_count.count; index++) {
        let light = lights[index];
        let away = light.position - position;
        let towards = select(away * inverseSqrt(max(dot(away, away), 1e-30)), -light.direction, light.shape == SUN);
        sum += arriving(light, position, towards) * phase(dot(towards, ray));
    }
    return fog.eye_per_y.w * sum;
}

@compute @workgroup_size(8, 8)
fn fill(@builtin(global_invocation_id) id: vec3u) {
    if id.x >= fog.size.x || id.y >= fog.size.y {
        return;
    }
    let pixel = (vec2f(id.xy) + 0.5) * f32(fog.size.w);
    let ndc = vec2f(2.0, -2.0) * pixel / fog.picture.xy + vec2f(-1.0, 1.0);
    let eye = fog.eye.xyz + fog.eye_per_x.xyz * ndc.x + fog.eye_per_y.xyz * ndc.y;
    let along = fog.ray.xyz + fog.ray_per_x.xyz * ndc.x + fog.ray_per_y.xyz * ndc.y;
    let per_depth = length(along);
    var sum = vec4f(0.0);
    for (var slice = 0u; slice < fog.size.z; slice++) {
        let position = eye + along * depth_of(f32(slice) + 0.5);
        let length_m = (depth_of(f32(slice) + 1.0) - depth_of(f32(slice))) * per_depth;
        let thickness = extinction_at(position) * length_m;
        let light = scattered(position, along / per_depth) * stopped_by(thickness);
        sum = vec4f(sum.rgb + exp(-sum.w) * light, sum.w + thickness);
        froxels[froxel(id.xy, slice)] = sum;
    }
}
