// Weights of viewpoints; joined behind `viewpoints.wgsl`, whoever joins it binds `viewpoints` and `present`.

// How viewpoints are weighed at a place of the object.
struct Weighing {
    // Least share of the way along an axis.
    least: f32,
    // Sum of weights.
    total: f32,
}

// Weight of a viewpoint that sees something before all are divided by their sum.
fn raw_weight(viewpoint: u32, at_m: vec3f, least: f32) -> f32 {
    let share = clamp(0.5 + 0.5 * (at_m - viewpoints.middle_m) / viewpoints.half_m, vec3f(0.0), vec3f(1.0));
    let at = share * vec3f(viewpoints.counts - 1u);
    let along = max(1.0 - abs(at - step_of(viewpoint)), vec3f(least));
    return f32(present[viewpoint]) * along.x * along.y * along.z;
}

fn total_at(at_m: vec3f, least: f32) -> f32 {
    var total = 0.0;
    for (var viewpoint = 0u; viewpoint < viewpoints.count; viewpoint++) {
        total += raw_weight(viewpoint, at_m, least);
    }
    return total;
}

// Trilinear between those that see something; beside others, the nearest of them.
fn weighing_at(at_m: vec3f) -> Weighing {
    let exact = total_at(at_m, 0.0);
    if exact >= TOTAL_MIN {
        return Weighing(0.0, exact);
    }
    return Weighing(ASIDE, max(total_at(at_m, ASIDE), 1e-30));
}

fn weight_of(viewpoint: u32, at_m: vec3f, weighing: Weighing) -> f32 {
    return raw_weight(viewpoint, at_m, weighing.least) / weighing.total;
}
