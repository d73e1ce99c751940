// Weights of viewpoints; joined behind `viewpoints.wgsl`, whoever joins it binds `viewpoints` and `present`.

// Weight of a viewpoint at a place of the object: trilinear between those that see something.
fn weight_of(viewpoint: u32, at_m: vec3f) -> f32 {
    if viewpoints.count != VIEWPOINTS_MAX {
        return f32(present[viewpoint]);
    }
    let share = clamp(0.5 + 0.5 * (at_m - viewpoints.middle_m) / viewpoints.half_m, vec3f(0.0), vec3f(1.0));
    for (var turn = 0u; turn < 2u; turn++) {
        var total = 0.0;
        var own = 0.0;
        for (var other = 0u; other < VIEWPOINTS_MAX; other++) {
            let along = max(select(1.0 - share, share, corner_of(other)), vec3f(select(0.0, ASIDE, turn == 1u)));
            let weight = f32(present[other]) * along.x * along.y * along.z;
            total += weight;
            own += select(0.0, weight, other == viewpoint);
        }
        if total >= 1e-3 {
            return own / total;
        }
    }
    return 0.0;
}
