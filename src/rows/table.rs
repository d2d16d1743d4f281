//! Structs that stand in tables: the same bytes for the CPU's loops and for shaders.
//!
//! [`table!`](crate::table) writes a struct down once. Its WGSL declaration is made from it ([`Wgsl`]), so that the two cannot differ. All members
//! have four bytes in `f32`, so there is no padding in either language.

/// No such column, block or entry.
pub const NONE: u32 = u32::MAX;

/// A type that stands in buffers, as WGSL writes it.
pub trait Wgsl {
    /// Its name there.
    fn name() -> String;

    /// Adds the declarations that it needs, by name, each behind those that it needs itself.
    fn declare(_into: &mut Vec<(String, String)>) {}

    /// How many words of four bytes it has.
    const WORDS: u32;

    /// The expression that makes it of the words of `tables` from `at + first` on.
    fn read(first: u32) -> String;

    /// Adds the arrays that it holds.
    ///
    /// * `name` - what its name is made from: the table, and the members on the way
    /// * `first` - where it begins in the table's entry, words
    fn arrays(_name: &str, _first: u32, _into: &mut Vec<MemberArray>) {}
}

/// An array in an entry of a table.
#[derive(Debug)]
pub struct MemberArray {
    /// Table and members, in its order.
    pub name: String,
    /// Where it begins in the entry, words.
    pub first: u32,
    /// Words of one of its values.
    pub words: u32,
    /// Type of its values.
    pub of: String,
    /// [`Wgsl::read`] of one.
    pub read: fn(u32) -> String,
}

impl Wgsl for f32 {
    fn name() -> String {
        "f32".into()
    }

    const WORDS: u32 = 1;

    fn read(first: u32) -> String {
        format!("bitcast<f32>(tables[at + {first}u])")
    }
}

impl Wgsl for u32 {
    fn name() -> String {
        "u32".into()
    }

    const WORDS: u32 = 1;

    fn read(first: u32) -> String {
        format!("tables[at + {first}u]")
    }
}

impl<M: Wgsl, const N: usize> Wgsl for [M; N] {
    fn name() -> String {
        format!("array<{}, {N}>", M::name())
    }

    fn declare(into: &mut Vec<(String, String)>) {
        M::declare(into);
    }

    const WORDS: u32 = M::WORDS * N as u32;

    fn read(first: u32) -> String {
        let values: Vec<String> = (0..N as u32).map(|i| M::read(first + i * M::WORDS)).collect();
        format!("{}({})", Self::name(), values.join(", "))
    }

    fn arrays(name: &str, first: u32, into: &mut Vec<MemberArray>) {
        into.push(MemberArray { name: name.into(), first, words: M::WORDS, of: M::name(), read: M::read });
    }
}

/// Declares structs that stand in tables, `#[repr(C)]` and with members of four bytes alone, and makes their WGSL declarations.
#[macro_export]
#[doc(hidden)]
macro_rules! table {
    ($($(#[$about:meta])* pub struct $name:ident $(<$scalar:ident>)? { $($(#[$of_member:meta])* pub $member:ident: $type:ty,)* })*) => {$(
        $(#[$about])*
        #[derive(Debug, Clone, Copy)]
        #[repr(C)]
        pub struct $name $(<$scalar>)? {
            $($(#[$of_member])* pub $member: $type,)*
        }

        impl $(<$scalar: $crate::rows::table::Wgsl>)? $crate::rows::table::Wgsl for $name $(<$scalar>)? {
            fn name() -> String {
                stringify!($name).into()
            }

            fn declare(into: &mut Vec<(String, String)>) {
                $(<$type as $crate::rows::table::Wgsl>::declare(into);)*
                if into.iter().all(|(name, _)| name != stringify!($name)) {
                    let mut text = concat!("struct ", stringify!($name), " {\n").to_string();
                    $(text += &format!("    {}: {},\n", stringify!($member), <$type as $crate::rows::table::Wgsl>::name());)*
                    into.push((stringify!($name).into(), text + "}\n"));
                }
            }

            const WORDS: u32 = 0 $(+ <$type as $crate::rows::table::Wgsl>::WORDS)*;

            fn read(first: u32) -> String {
                let (mut values, mut at) = (Vec::new(), first);
                $(
                    values.push(<$type as $crate::rows::table::Wgsl>::read(at));
                    at += <$type as $crate::rows::table::Wgsl>::WORDS;
                )*
                debug_assert_eq!(at, first + Self::WORDS);
                format!("{}({})", stringify!($name), values.join(", "))
            }

            fn arrays(name: &str, first: u32, into: &mut Vec<$crate::rows::table::MemberArray>) {
                let mut at = first;
                $(
                    <$type as $crate::rows::table::Wgsl>::arrays(&format!("{name}_{}", stringify!($member)), at, into);
                    at += <$type as $crate::rows::table::Wgsl>::WORDS;
                )*
                debug_assert_eq!(at, first + Self::WORDS);
            }
        }

        $crate::table!(@sent $name $(<$scalar>)?);
    )*};
    (@sent $name:ident) => {
        // SAFETY: `#[repr(C)]`, with members of four bytes alone and so without padding; `tests/library/shader_layout.rs` compares sizes.
        unsafe impl bytemuck::NoUninit for $name {}
    };
    (@sent $name:ident <$scalar:ident>) => {
        // SAFETY: likewise.
        unsafe impl bytemuck::NoUninit for $name<f32> {}
    };
}

table! {
    /// Consecutive entries of another table.
    #[derive(PartialEq, Eq, Default)]
    pub struct Span {
        /// First entry.
        pub start: u32,
        /// One past the last.
        pub end: u32,
    }

    /// Consecutive variables: in `x` (those of a front's moves may leave some out there), in the front, and in the columns of an element or in the
    /// previous front.
    #[derive(PartialEq, Eq)]
    pub struct Run {
        /// First variable.
        pub variable: u32,
        /// Its index in the front.
        pub front: u32,
        /// Its column in the element, or its index in the previous front.
        pub column: u32,
        /// How many.
        pub len: u32,
    }

    /// Where an element's rows stand in the buffers.
    #[derive(Default)]
    pub struct Place {
        /// First Jacobian row; equalities come first, so for them also the index of the residual.
        pub row: u32,
        /// First inequality; the upper sides of all rows, then the lower sides of the first `pairs`.
        pub inequality: u32,
        /// Offset in the Jacobian values, row-major.
        pub jacobian: u32,
        /// Distance of two rows there, a multiple of 8; the padding is zero.
        pub stride: u32,
    }
}

impl Span {
    /// As indices.
    #[inline(always)]
    pub fn range(self) -> std::ops::Range<usize> {
        self.start as usize..self.end as usize
    }

    /// What was added to a table that had `start` entries.
    pub fn added<E>(start: usize, table: &[E]) -> Span {
        Span { start: start as u32, end: table.len() as u32 }
    }
}
