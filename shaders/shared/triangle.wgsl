// Cells of an upper triangle, as work for many invocations.

// Number of cells to visit for the upper triangle of `count` columns, see `cell`.
fn cells(count: u32) -> u32 {
    let even = count + (count & 1u);
    return (even / 2u) * (even + 1u);
}

// Row and column of cell `e`. The triangle is folded into a rectangle whose row `r` holds rows `r` and `even - 1 - r` of the triangle. If
// `count` is odd, some cells have a column of `count`; the caller must skip them.
fn cell(count: u32, e: u32) -> vec2<u32> {
    let even = count + (count & 1u);
    let r = e / (even + 1u);
    let at = e - r * (even + 1u);
    if (at < even - r) {
        return vec2<u32>(r, r + at);
    }
    return vec2<u32>(even - 1u - r, at - 1u);
}

// Number of cell (i, j), `i <= j`, of the upper triangle of `count` columns: row by row, each from its diagonal.
fn number_of(count: u32, i: u32, j: u32) -> u32 {
    return i * count - (i * (i + 1u)) / 2u + j;
}
