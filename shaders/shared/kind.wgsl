// Kinds of rows: Jacobian rows are numbered by kind, equalities first, then costs, then inequalities.

// Kind of a row: EQUALITY, COST or INEQUALITY. Twin: `RowCounts::kind` of src/rows/mod.rs
fn row_kind(rows: RowCounts, row: u32) -> u32 {
    return select(select(INEQUALITY, COST, row < rows.equalities + rows.costs), EQUALITY, row < rows.equalities);
}
