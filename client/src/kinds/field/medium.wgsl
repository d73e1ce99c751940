// Mean radiance over all directions of a point in free space, which a medium scatters. Joined behind `field.wgsl`.

fn mean_radiance(point: vec3f) -> vec3f {
    // Y_0 of any normal: irradiance is pi times as much in the mean over normals.
    return field_sum(field_at(point), array<f32, 9>(0.28209479, 0.0, 0.0, 0.0, 0.0, 0.0, 0.0, 0.0, 0.0)) / PI;
}
