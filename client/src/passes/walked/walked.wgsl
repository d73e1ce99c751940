// Radiance at the ends of walks → irradiance at the receivers that have any; twin: reference.rs. One thread per receiver.
// `N_r = w Σ ±λ`, beside the light of near hits, which their pass wrote before.

struct Walked {
    row_count: u32,
    // Threads in a row of the dispatch.
    stride: u32,
    weight: f32,
}

struct WalkedRow {
    slot: u32,
    first: u32,
    count: u32,
    has_near: u32,
}

// Bit of an end whose light is taken away.
const TAKEN = 0x80000000u;

@group(0) @binding(0) var<uniform> numbers: Walked;
@group(0) @binding(1) var<storage, read> rows: array<WalkedRow>;
// Places in λ.
@group(0) @binding(2) var<storage, read> places: array<u32>;
@group(0) @binding(3) var<storage, read> lambda: array<vec4f>;
// By slot.
@group(0) @binding(4) var<storage, read_write> e_near: array<vec4f>;

@compute @workgroup_size(64)
fn gather(@builtin(global_invocation_id) thread: vec3u) {
    let index = thread.y * numbers.stride + thread.x;
    if index >= numbers.row_count {
        return;
    }
    let row = rows[index];
    // The mark of a receiver that no bounce computes.
    if e_near[row.slot].w != 0.0 {
        return;
    }
    var sum = vec3f(0.0);
    for (var at = row.first; at < row.first + row.count; at++) {
        let light = lambda[places[at] & ~TAKEN].rgb;
        sum += select(light, -light, (places[at] & TAKEN) != 0u);
    }
    let before = select(vec3f(0.0), e_near[row.slot].rgb, row.has_near != 0u);
    e_near[row.slot] = vec4f(before + numbers.weight * sum, 0.0);
}
