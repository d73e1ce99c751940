// Irradiance that objects change at receivers: sum of v h ΔE; twin: reference.rs. One thread per receiver.

struct MovedNumbers {
    // Rows of the map from the receivers' space to the world.
    rows: array<vec4f, 3>,
    count: u32,
    // Threads in a row of the dispatch.
    stride: u32,
    // The object whose receivers they are, or none.
    own: u32,
    pad: u32,
}

@group(1) @binding(0) var<uniform> numbers: MovedNumbers;
// By slot.
@group(1) @binding(1) var<storage, read> positions: array<vec4f>;
@group(1) @binding(2) var<storage, read> normals: array<vec4f>;
@group(1) @binding(3) var<storage, read_write> moved: array<vec4f>;
@group(1) @binding(4) var<storage, read> movers: Movers;
@group(1) @binding(5) var<storage, read> codes: array<u32>;
@group(1) @binding(6) var<storage, read> part_light: array<vec4f>;

@compute @workgroup_size(64)
fn change_texels(@builtin(global_invocation_id) thread: vec3u) {
    let slot = thread.y * numbers.stride + thread.x;
    if slot >= numbers.count {
        return;
    }
    let at = vec4f(positions[slot].xyz, 1.0);
    let own = normals[slot].xyz;
    let position = vec3f(dot(numbers.rows[0], at), dot(numbers.rows[1], at), dot(numbers.rows[2], at));
    let normal = normalize(vec3f(dot(numbers.rows[0].xyz, own), dot(numbers.rows[1].xyz, own), dot(numbers.rows[2].xyz, own)));
    find_changes(numbers.own, position, normal);
    var sum = vec3f(0.0);
    for (var index = 0u; index < movers.count; index++) {
        if any(changes[index] != vec3f(0.0)) {
            sum += changes[index] * light_irradiance(lights[movers.first_light + index], position, normal, normal).w;
        }
    }
    moved[slot] = vec4f(sum + given_to(numbers.own, position, normal, normal), 0.0);
}
