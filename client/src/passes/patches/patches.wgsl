// Radiance of receivers → mean radiance of patches, and differences; twin: reference.rs. One thread per leaf, then one per block
// of leaves and one per block of blocks, then one per patch, twice.
// `L = ρ/π·(E_dir + E_emit + E_ind)`; emission is left out, as its irradiance is baked with its own shadows.

struct Patches {
    receiver_count: u32,
    leaf_count: u32,
    patch_count: u32,
    // Threads in a row of the dispatch.
    stride: u32,
    // Sums of blocks of leaves stand behind the leaves, sums of blocks of these behind them.
    first_block: u32,
    first_large: u32,
    // Where sum_blocks begins to read, and where it ends; it writes behind that.
    block_source: vec2u,
}

struct PatchRow {
    first_leaf: u32,
    leaf_count: u32,
    // The patch that it is part of; past the last one for roots.
    parent: u32,
}

const PI = 3.14159265358979;
// Numbers of a block.
const BLOCK = 64u;

@group(0) @binding(0) var<uniform> numbers: Patches;
// First entry of each leaf in slots, and the end.
@group(0) @binding(1) var<storage, read> leaf_starts: array<u32>;
@group(0) @binding(2) var<storage, read> slots: array<u32>;
@group(0) @binding(3) var<storage, read> albedo: array<vec4f>;
@group(0) @binding(4) var<storage, read> e_dir: array<vec4f>;
@group(0) @binding(5) var<storage, read> e_emit: array<vec4f>;
@group(0) @binding(6) var<storage, read> e_ind: array<vec4f>;
// Area of each in texels.
@group(0) @binding(10) var<storage, read> areas: array<f32>;
// Sum over the surface of each leaf, and of each block; w is its area.
@group(0) @binding(7) var<storage, read_write> leaves: array<vec4f>;
@group(0) @binding(8) var<storage, read> patches: array<PatchRow>;
// Patches, then their differences from the patches that they are part of, then parts of the sky, which do not change.
@group(0) @binding(9) var<storage, read_write> lambda: array<vec4f>;

@compute @workgroup_size(64)
fn sum_leaves(@builtin(global_invocation_id) thread: vec3u) {
    let leaf = thread.y * numbers.stride + thread.x;
    if leaf >= numbers.leaf_count {
        return;
    }
    var sum = vec3f(0.0);
    var area = 0.0;
    for (var index = leaf_starts[leaf]; index < leaf_starts[leaf + 1u]; index++) {
        let slot = slots[index];
        // Receivers that no light reaches have no slot.
        if slot < numbers.receiver_count {
            sum += areas[index] * albedo[slot].rgb * (1.0 / PI) * (e_dir[slot].rgb + e_emit[slot].rgb + e_ind[slot].rgb);
        }
        area += areas[index];
    }
    leaves[leaf] = vec4f(sum, area);
}

@compute @workgroup_size(64)
fn sum_blocks(@builtin(global_invocation_id) thread: vec3u) {
    let block = thread.y * numbers.stride + thread.x;
    let first = numbers.block_source.x + block * BLOCK;
    let end = numbers.block_source.y;
    if first >= end {
        return;
    }
    var sum = vec4f(0.0);
    for (var at = first; at < min(first + BLOCK, end); at++) {
        sum += leaves[at];
    }
    leaves[end + block] = sum;
}

@compute @workgroup_size(64)
fn mean_of_patches(@builtin(global_invocation_id) thread: vec3u) {
    let index = thread.y * numbers.stride + thread.x;
    if index >= numbers.patch_count {
        return;
    }
    let row = patches[index];
    var sum = vec4f(0.0);
    var leaf = row.first_leaf;
    let end = leaf + row.leaf_count;
    while leaf < end {
        if leaf % (BLOCK * BLOCK) == 0u && end - leaf >= BLOCK * BLOCK {
            sum += leaves[numbers.first_large + leaf / (BLOCK * BLOCK)];
            leaf += BLOCK * BLOCK;
        } else if leaf % BLOCK == 0u && end - leaf >= BLOCK {
            sum += leaves[numbers.first_block + leaf / BLOCK];
            leaf += BLOCK;
        } else {
            sum += leaves[leaf];
            leaf += 1u;
        }
    }
    lambda[index] = vec4f(sum.rgb / sum.w, 0.0);
}

@compute @workgroup_size(64)
fn difference_of_patches(@builtin(global_invocation_id) thread: vec3u) {
    let index = thread.y * numbers.stride + thread.x;
    if index >= numbers.patch_count {
        return;
    }
    var difference = lambda[index];
    let parent = patches[index].parent;
    if parent < numbers.patch_count {
        difference -= lambda[parent];
    }
    lambda[numbers.patch_count + index] = difference;
}
