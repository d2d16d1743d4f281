//! Builder of factored rows: collects instants and elements, then assigns columns to them. See [`crate::rows::factored`].

use super::columns::Columns;
use super::problem::Element;
use super::sweep::{self, Block};
use crate::real::Real;
use crate::rows::Spec;
use crate::rows::blocks::{BlockId, Use};
use crate::rows::factored::{
    BaseBlocks, FactoredElement, FactoredInstant, FactoredRows, FirstRows, OWN_BLOCKS, OwnColumns, POSE, POSE_BLOCKS,
};
use crate::rows::table::Span;

/// Instants and own columns of the factored rows of one family, which have no columns yet.
#[derive(Default)]
pub(super) struct FactoredDrafts {
    /// Instants, in the order of their table.
    instants: Vec<InstantDraft>,
    /// Own columns. Until [`FactoredDrafts::place`], elements refer to these indices.
    own: Vec<OwnDraft>,
}

/// Instant whose columns are not known yet.
struct InstantDraft {
    step: usize,
    /// See [`BaseBlocks::interval`].
    interval: u32,
    /// Base blocks.
    base: [Use; POSE_BLOCKS],
}

/// Own columns that are not known yet.
struct OwnDraft {
    /// Blocks that the rows use in addition to the base.
    uses: [Use; OWN_BLOCKS],
    /// Last step for which the columns were assigned, their index in [`FactoredRows::own`] for that step, and the number of all columns.
    assigned: (usize, u32, u32),
}

impl FactoredDrafts {
    /// Reserves capacity.
    pub fn reserve<T: Real, const R: usize>(&mut self, rows: &mut FactoredRows<T, R>, instants: usize, elements: usize) {
        rows.instants.reserve_exact(instants);
        self.instants.reserve_exact(instants);
        rows.elements.reserve_exact(elements);
    }

    /// Adds an instant without elements. Its step must not be before that of the previous instant.
    pub fn instant<T: Real, const R: usize>(
        &mut self,
        rows: &mut FactoredRows<T, R>,
        blocks: &mut [Block],
        step: usize,
        interval: u32,
        weights: [T; POSE_BLOCKS],
        base: [BlockId; POSE_BLOCKS],
    ) {
        let base = std::array::from_fn(|i| if weights[i] == T::zero() { Use::Reads(base[i]) } else { Use::Touches(base[i]) });
        sweep::touch(blocks, step, &base);
        let end = rows.elements.len() as u32;
        rows.instants.push(FactoredInstant { weights, blocks: 0, elements: Span { start: end, end } });
        self.instants.push(InstantDraft { step, interval, base });
    }

    /// Adds own columns. Returns their index.
    pub fn own(&mut self, uses: [Use; OWN_BLOCKS]) -> u32 {
        self.own.push(OwnDraft { uses, assigned: (usize::MAX, 0, 0) });
        self.own.len() as u32 - 1
    }

    /// Adds an element to the last instant.
    pub fn element<T: Real, const R: usize>(&mut self, rows: &mut FactoredRows<T, R>, blocks: &mut [Block], own: u32) {
        if let (Some(instant), Some(draft)) = (rows.instants.last_mut(), self.instants.last()) {
            instant.elements.end += 1;
            sweep::touch(blocks, draft.step, &self.own[own as usize].uses);
            rows.elements.push(FactoredElement { own, jacobian: 0, stride: 0 });
        }
    }

    /// Assigns columns and places to all elements.
    ///
    /// * `steps` - number of steps of the sweep
    pub fn place<T: Real, const R: usize>(mut self, rows: &mut FactoredRows<T, R>, columns: &mut Columns, steps: usize) {
        let spec = rows.spec;
        let [row, inequality] = columns.next_rows(spec.kind);
        rows.first = FirstRows { row, inequality };
        rows.steps = vec![Span::default(); steps];
        // Step, interval and blocks of the previous instant.
        let mut last = None;
        for (number, InstantDraft { step, interval, base }) in self.instants.iter().enumerate() {
            let (step, shared) = (*step, (step, interval, base));
            if last != Some(shared) {
                last = Some(shared);
                columns.assign(step, base, 0);
                let (variable, front) = (|i: usize| columns.seats[i].position, |i: usize| columns.seats[i].front);
                let [variable, front] = [std::array::from_fn(variable), std::array::from_fn(front)];
                rows.base_blocks.push(BaseBlocks { variable, front, interval: *interval });
            }
            let instant = &mut rows.instants[number];
            instant.blocks = rows.base_blocks.len() as u32 - 1;
            for element in &mut rows.elements[instant.elements.range()] {
                let OwnDraft { uses, assigned } = &mut self.own[element.own as usize];
                if assigned.0 != step {
                    columns.assign(step, uses, POSE as u32);
                    *assigned = (step, rows.own.len() as u32, columns.count);
                    rows.own.push(OwnColumns { runs: std::array::from_fn(|role| columns.run(role, &uses[role])) });
                }
                let place = columns.place(spec, spec.pairs, assigned.2);
                *element = FactoredElement { own: assigned.1, jacobian: place.jacobian, stride: place.stride };
            }
            rows.steps[step].end = number as u32 + 1;
        }
        sweep::close(rows.steps.iter_mut());
    }
}

impl<T: Real, const R: usize> FactoredRows<T, R> {
    /// Specification of each element.
    pub(super) fn specs(&self) -> impl Iterator<Item = Spec> {
        std::iter::repeat_n(self.spec, self.elements.len())
    }

    /// Elements, without runs: [`FactoredRows::columns`] has their columns.
    pub fn as_elements(&self) -> impl Iterator<Item = Element> {
        let (rows, pairs) = (R as u32, self.spec.pairs as u32);
        let element = move |number| Element { family: self.family, rows, pairs, place: self.place(number), runs: Span::default() };
        (0..self.elements.len()).map(element)
    }
}
