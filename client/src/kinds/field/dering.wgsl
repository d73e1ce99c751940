// Light at probes without ringing; twin: `deringed` of the run time. One thread a probe.

// Harmonics of the directions along which light is looked at, nine each.
@group(0) @binding(0) var<storage, read> looks: array<f32>;
// Coefficients of irradiance by normal, nine a probe.
@group(0) @binding(1) var<storage, read_write> rows: array<vec4f>;

const PROBE_ROWS = 9u;

@compute @workgroup_size(64)
fn dering(@builtin(global_invocation_id) thread: vec3u) {
    let first = thread.x * PROBE_ROWS;
    if first + PROBE_ROWS > arrayLength(&rows) {
        return;
    }
    var own: array<vec3f, PROBE_ROWS>;
    for (var j = 0u; j < PROBE_ROWS; j++) {
        own[j] = rows[first + j].rgb;
    }
    // The mean over directions, and the least of all else.
    let mean = own[0] * looks[0];
    var least = vec3f(0.0);
    for (var look = 0u; look < arrayLength(&looks); look += PROBE_ROWS) {
        var sum = vec3f(0.0);
        for (var j = 1u; j < PROBE_ROWS; j++) {
            sum += own[j] * looks[look + j];
        }
        least = min(least, sum);
    }
    // Where least is 0, it is not below −mean, unless that is below 0.
    let share = select(vec3f(1.0), max(mean, vec3f(0.0)) / max(-least, vec3f(1e-30)), least < -mean);
    for (var j = 1u; j < PROBE_ROWS; j++) {
        rows[first + j] = vec4f(own[j] * share, rows[first + j].w);
    }
}
