// E_dir of receivers: the mean over the points of each texel; twin: reference.rs. One thread per receiver.

struct TexelNumbers {
    // Slot of the first receiver.
    first: u32,
    count: u32,
    // Threads in a row of the dispatch.
    stride: u32,
    // Metres that an offset of 1 is.
    reach_m: f32,
}

struct TexelPoint {
    position: vec3f,
    normal: vec3f,
}

// Points that are looked at first, and the share of light from which on a point counts as lit.
const FEW_POINTS = 4u;
const ALL_LIT = 0.999;
// Points of one texel; a receiver of more stands for other texels, and all of them count.
const TEXEL_POINTS = 16u;

@group(1) @binding(0) var<uniform> texels: TexelNumbers;
// By slot, as e_dir.
@group(1) @binding(1) var<storage, read> positions: array<vec4f>;
@group(1) @binding(2) var<storage, read> normals: array<vec4f>;
@group(1) @binding(3) var<storage, read_write> e_dir: array<vec4f>;
// First point of each receiver from `first` on, and the end.
@group(1) @binding(4) var<storage, read> starts: array<u32>;
// Offset x, y and z as snorm16, octahedral normal as snorm8.
@group(1) @binding(5) var<storage, read> points: array<vec2u>;

fn texel_point(index: u32, from_m: vec3f) -> TexelPoint {
    let words = points[index];
    let offset = vec3f(unpack2x16snorm(words.x), unpack2x16snorm(words.y).x);
    let folded = unpack4x8snorm(words.y).zw;
    var normal = vec3f(folded, 1.0 - abs(folded.x) - abs(folded.y));
    if normal.z < 0.0 {
        let sign = select(vec2f(-1.0), vec2f(1.0), folded >= vec2f(0.0));
        normal = vec3f((1.0 - abs(folded.yx)) * sign, normal.z);
    }
    return TexelPoint(from_m + texels.reach_m * offset, normalize(normal));
}

@compute @workgroup_size(64)
fn direct_texels(@builtin(global_invocation_id) id: vec3u) {
    let row = id.y * texels.stride + id.x;
    if row >= texels.count {
        return;
    }
    let slot = texels.first + row;
    let own = positions[slot].xyz;
    let begin = starts[row];
    let end = starts[row + 1u];
    let is_own = begin == end;
    // All points of one texel only where the first few do not agree; one without points has its own.
    let few = select(select(min(begin + FEW_POINTS, end), end, end - begin > TEXEL_POINTS), begin + 1u, is_own);
    let last = max(end, few);
    let whole = TexelPoint(own, normals[slot].xyz);
    var sum = vec3f(0.0);
    for (var index = 0u; index < light_count.count; index++) {
        let light = lights[index];
        var of_light = vec3f(0.0);
        var least = 1.0;
        var most = 0.0;
        var counted = few;
        for (var i = begin; i < counted; i++) {
            var point = whole;
            if !is_own {
                point = texel_point(i, own);
            }
            point = TexelPoint(placed(point.position), turned(point.normal));
            let found = light_irradiance(light, point.position, point.normal, point.normal);
            of_light += found.rgb;
            least = min(least, found.w);
            most = max(most, found.w);
            if i + 1u == few && most > 0.0 && least < ALL_LIT {
                counted = last;
            }
        }
        sum += of_light / f32(counted - begin);
    }
    e_dir[slot] = vec4f(sum, 0.0);
}
