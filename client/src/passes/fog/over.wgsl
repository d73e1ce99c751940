// The medium before a picture. Joined behind `numbers.wgsl`. Twin: reference.rs.

@group(0) @binding(0) var<uniform> fog: Fog;
@group(0) @binding(1) var<storage, read> froxels: array<vec4f>;
@group(0) @binding(2) var depths: texture_depth_2d;

@vertex
fn whole(@builtin(vertex_index) index: u32) -> @builtin(position) vec4f {
    return vec4f(vec2f(f32(index & 1u), f32(index >> 1u)) * 4.0 - 1.0, 0.0, 1.0);
}

// Radiance that a slice of a thick medium would send, from the sums before and behind it.
fn sent(before: vec4f, end: vec4f) -> vec3f {
    return (end.rgb - before.rgb) / max(exp(-before.w) * stopped_by(end.w - before.w), 1e-30);
}

// Light scattered and optical thickness up to a depth in a column. Where the depth ends within a slice, what is scattered there is that of
// the slice before, as the middle of its own may lie behind what is seen; past the middle it goes over to its own.
fn up_to(column: vec2u, slices: f32) -> vec4f {
    let slice = min(u32(slices), fog.size.z - 1u);
    let part = (depth_of(slices) - depth_of(f32(slice))) / (depth_of(f32(slice) + 1.0) - depth_of(f32(slice)));
    let end = froxels[froxel(column, slice)];
    var start = vec4f(0.0);
    var radiance = sent(start, end);
    if slice > 0u {
        start = froxels[froxel(column, slice - 1u)];
        var before = vec4f(0.0);
        if slice > 1u {
            before = froxels[froxel(column, slice - 2u)];
        }
        radiance = mix(sent(before, start), sent(start, end), clamp(2.0 * part - 1.0, 0.0, 1.0));
    }
    let thickness = (end.w - start.w) * part;
    return vec4f(start.rgb + radiance * exp(-start.w) * stopped_by(thickness), start.w + thickness);
}

@fragment
fn over(@builtin(position) at: vec4f) -> @location(0) vec4f {
    let z = textureLoad(depths, vec2u(at.xy), 0);
    let below = z * fog.by_depth.w - fog.by_depth.y;
    let depth = select((fog.by_depth.x - z * fog.by_depth.z) / below, fog.picture.z, z <= 0.0 || below == 0.0);
    let slices = f32(fog.size.z) * sqrt(clamp(depth / fog.picture.z, 0.0, 1.0));
    let columns = clamp(at.xy / f32(fog.size.w) - 0.5, vec2f(0.0), vec2f(fog.size.xy - 1u));
    let first = vec2u(columns);
    let next = min(first + 1u, fog.size.xy - 1u);
    let share = columns - vec2f(first);
    let upper = mix(up_to(first, slices), up_to(vec2u(next.x, first.y), slices), share.x);
    let lower = mix(up_to(vec2u(first.x, next.y), slices), up_to(next, slices), share.x);
    let found = mix(upper, lower, share.y);
    return vec4f(found.rgb, exp(-found.w));
}
