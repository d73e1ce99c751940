// b_c = s (ΣVᵀ) λ|_c; twin: reference.rs. One workgroup per cluster, a thread for each eight ranks and each share of the columns. λ at
// the cluster's columns is gathered once, then read by all ranks. Few clusters have most of the columns, so the time is theirs: as
// many threads as a group may have, four columns of each under way at once.

struct Basis {
    // Clusters in a row of the dispatch.
    stride: u32,
    cluster_count: u32,
    // The page's first among all.
    first_cluster: u32,
}

struct Column {
    // Place in lambda.
    place: u32,
    scale: f32,
}

// Few on processors, which run them one after the other (`PROCESSOR_THREADS` in mod.rs).
override THREADS: u32 = 256u;
// Columns gathered at a time.
const TILE = 1024u;
const CHANNELS = 3u;

@group(0) @binding(0) var<uniform> basis: Basis;
@group(0) @binding(1) var<storage, read> clusters: array<Cluster>;
@group(0) @binding(2) var<storage, read> columns: array<Column>;
// For each eight ranks, for each column: a group.
@group(0) @binding(3) var<storage, read> vt: array<u32>;
@group(0) @binding(4) var<storage, read> steps: array<f32>;
@group(0) @binding(5) var<storage, read> lambda: array<vec4f>;
@group(0) @binding(6) var<storage, read_write> b: array<vec4f>;
@group(0) @binding(7) var<storage, read> details: array<Detail>;
@group(0) @binding(8) var<uniform> turn: Turn;

// λ of a tile's columns; behind the last tile, sums of threads.
var<workgroup> numbers: array<f32, TILE * CHANNELS>;
// The thread's sums for its eight ranks.
var<private> own: array<vec3f, GROUP>;

// λ at a column of the tile.
fn light(at: u32) -> vec3f {
    return vec3f(numbers[at * CHANNELS], numbers[at * CHANNELS + 1u], numbers[at * CHANNELS + 2u]);
}

// Adds a column's light to the thread's eight ranks.
fn add(low: vec4f, high: vec4f, column: vec3f) {
    own[0] += low.x * column;
    own[1] += low.y * column;
    own[2] += low.z * column;
    own[3] += low.w * column;
    own[4] += high.x * column;
    own[5] += high.y * column;
    own[6] += high.z * column;
    own[7] += high.w * column;
}

// The same for factors of 4 bits.
fn add_word(word: u32, column: vec3f) {
    let low = bitcast<vec4i>(vec4u(word << 28u, word << 24u, word << 20u, word << 16u)) >> vec4u(28u);
    let high = bitcast<vec4i>(vec4u(word << 12u, word << 8u, word << 4u, word)) >> vec4u(28u);
    add(vec4f(low), vec4f(high), column);
}

// Hands a thread's sums over: of each channel of each rank those of `held` threads in a row.
fn hand_over(thread: u32, held: u32) {
    for (var i = 0u; i < GROUP; i++) {
        let at = i * CHANNELS * held + thread;
        numbers[at] = own[i].x;
        numbers[at + held] = own[i].y;
        numbers[at + 2u * held] = own[i].z;
    }
}

// Those that another thread handed over, joined to the thread's own.
fn take_over(thread: u32, held: u32) {
    for (var i = 0u; i < GROUP; i++) {
        let at = i * CHANNELS * held + thread;
        own[i] += vec3f(numbers[at], numbers[at + held], numbers[at + 2u * held]);
    }
}

@compute @workgroup_size(THREADS)
fn project(@builtin(workgroup_id) group: vec3u, @builtin(local_invocation_index) thread: u32) {
    let index = group.y * basis.stride + group.x;
    if index >= basis.cluster_count {
        return;
    }
    let cluster = clusters[index];
    let detail = details[basis.first_cluster + index];
    if !is_due(detail.interval, basis.first_cluster + index, turn.bounce) {
        return;
    }
    let groups = detail.groups;
    var lanes = 1u;
    while lanes < groups {
        lanes *= 2u;
    }
    let shares = THREADS / lanes;
    let share = thread / lanes;
    let has_ranks = thread % lanes < groups;
    // Columns that count, by class: wide ones, those of 8 bits, those of 4; and behind how many others each class lies.
    let wide_end = detail.wide;
    let bytes_end = wide_end + detail.bytes;
    let count = bytes_end + detail.rest;
    let before_bytes = cluster.wide - detail.wide;
    let before_rest = before_bytes + cluster.bytes - detail.bytes;
    // Words of a group of ranks.
    let bytes_first = cluster.wide * cluster.wide_words;
    let rest_first = bytes_first + cluster.bytes * OF_8;
    let of_group = rest_first + cluster.column_count - cluster.wide - cluster.bytes;
    let first = cluster.first_word + thread % lanes * of_group;
    for (var tile = 0u; tile < count; tile += TILE) {
        let end = min(tile + TILE, count);
        for (var at = thread; tile + at < end; at += THREADS) {
            let before = select(select(before_rest, before_bytes, tile + at < bytes_end), 0u, tile + at < wide_end);
            let column = columns[cluster.first_column + before + tile + at];
            let value = lambda[column.place] * column.scale;
            numbers[at * CHANNELS] = value.x;
            numbers[at * CHANNELS + 1u] = value.y;
            numbers[at * CHANNELS + 2u] = value.z;
        }
        workgroupBarrier();
        if has_ranks {
            var at = tile + share;
            for (; at < min(end, wide_end); at += shares) {
                let word = first + at * cluster.wide_words;
                let column = light(at - tile);
                if cluster.wide_words == OF_16 {
                    let low = of_16(vt[word], vt[word + 1u]);
                    add(low, of_16(vt[word + 2u], vt[word + 3u]), column);
                } else {
                    let low = bitcast<vec4f>(vec4u(vt[word], vt[word + 1u], vt[word + 2u], vt[word + 3u]));
                    let high = bitcast<vec4f>(vec4u(vt[word + 4u], vt[word + 5u], vt[word + 6u], vt[word + 7u]));
                    add(low, high, column);
                }
            }
            for (; at < min(end, bytes_end); at += shares) {
                let word = first + bytes_first + (at - wide_end) * OF_8;
                add(of_8(vt[word]), of_8(vt[word + 1u]), light(at - tile));
            }
            let words = first + rest_first - bytes_end;
            // The next four are read before the first is used.
            for (; at + 3u * shares < end; at += 4u * shares) {
                let next = vec4u(at, at + shares, at + 2u * shares, at + 3u * shares);
                let word = vec4u(vt[words + next.x], vt[words + next.y], vt[words + next.z], vt[words + next.w]);
                add_word(word.x, light(next.x - tile));
                add_word(word.y, light(next.y - tile));
                add_word(word.z, light(next.z - tile));
                add_word(word.w, light(next.w - tile));
            }
            for (; at < end; at += shares) {
                add_word(vt[words + at], light(at - tile));
            }
        }
        workgroupBarrier();
    }
    // Half of the threads at a time, until the sums of all fit.
    var held = THREADS;
    while held * GROUP * CHANNELS > TILE * CHANNELS {
        held /= 2u;
        if thread >= held && thread < 2u * held {
            hand_over(thread - held, held);
        }
        workgroupBarrier();
        if thread < held {
            take_over(thread, held);
        }
        workgroupBarrier();
    }
    if thread < held {
        hand_over(thread, held);
    }
    workgroupBarrier();
    for (var rank = thread; rank < min(cluster.rank, groups * GROUP); rank += THREADS) {
        var total = vec3f(0.0);
        for (var other = rank / GROUP; other < held; other += lanes) {
            let base = rank % GROUP * CHANNELS * held + other;
            total += vec3f(numbers[base], numbers[base + held], numbers[base + 2u * held]);
        }
        let at = cluster.first_b + rank;
        b[at] = vec4f(total * steps[at], 0.0);
    }
}
