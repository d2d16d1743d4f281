// Reductions over a workgroup, in a fixed order. Every invocation of the workgroup must call them, and every invocation gets the result.

var<workgroup> partial: array<f32, WORKGROUP>;

// Sum of `v` over the workgroup.
fn sum_over(lane: u32, v: f32) -> f32 {
    partial[lane] = v;
    for (var width = WORKGROUP / 2u; width > 0u; width /= 2u) {
        workgroupBarrier();
        if (lane < width) {
            partial[lane] += partial[lane + width];
        }
    }
    workgroupBarrier();
    let sum = partial[0];
    workgroupBarrier();
    return sum;
}

// Maximum of `v` over the workgroup.
fn max_over(lane: u32, v: f32) -> f32 {
    partial[lane] = v;
    for (var width = WORKGROUP / 2u; width > 0u; width /= 2u) {
        workgroupBarrier();
        if (lane < width) {
            partial[lane] = max(partial[lane], partial[lane + width]);
        }
    }
    workgroupBarrier();
    let largest = partial[0];
    workgroupBarrier();
    return largest;
}
