//! Structs stored in tables, with the same bytes for CPU loops and shaders.
//!
//! [`table!`](crate::table) declares a struct once and generates its WGSL declaration from it ([`Wgsl`]), so that the two cannot differ.
//! All members have four bytes in `f32`, so there is no padding in either language.

/// Marker of an absent column, block or entry.
pub const NONE: u32 = u32::MAX;

/// Type stored in buffers, with its WGSL declaration.
pub trait Wgsl {
    /// Name of the type in WGSL.
    fn name() -> String;

    /// Adds the declarations that the type needs, as pairs of name and text, dependencies first.
    fn declare(_into: &mut Vec<(String, String)>) {}

    /// Size in words of four bytes.
    const WORDS: u32;

    /// WGSL expression that constructs the type from the words of `tables` starting at `at + first`.
    fn read(first: u32) -> String;

    /// Adds the arrays that the type contains.
    ///
    /// * `name` - prefix of their names: the table and the members that lead to the type
    /// * `first` - offset of the type in the table's entry, words
    fn arrays(_name: &str, _first: u32, _into: &mut Vec<MemberArray>) {}
}

/// Array inside an entry of a table.
#[derive(Debug)]
pub struct MemberArray {
    /// Name of the array, formed from table and members.
    pub name: String,
    /// Offset of the array in the entry, words.
    pub first: u32,
    /// Size of one value, words.
    pub words: u32,
    /// WGSL type of the values.
    pub of: String,
    /// [`Wgsl::read`] of one value.
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

/// Declares structs for tables, `#[repr(C)]` and with members of four bytes only, and generates their WGSL declarations.
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
        // SAFETY: `#[repr(C)]` with members of four bytes only, so there is no padding; `tests/library/shader_layout.rs` compares sizes.
        unsafe impl bytemuck::NoUninit for $name {}
    };
    (@sent $name:ident <$scalar:ident>) => {
        // SAFETY: `#[repr(C)]` with members of four bytes only, so there is no padding; `tests/library/shader_layout.rs` compares sizes.
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

    /// Run of variables that are consecutive in the front and in the columns of an element or in the previous front. They are also
    /// consecutive in `x`, except that moves between fronts may skip variables there.
    #[derive(PartialEq, Eq)]
    pub struct Run {
        /// First variable.
        pub variable: u32,
        /// Index of the first variable in the front.
        pub front: u32,
        /// Column of the first variable in the element, or its index in the previous front.
        pub column: u32,
        /// Number of variables.
        pub len: u32,
    }

    /// Place of an element's rows in the buffers.
    #[derive(Default)]
    pub struct Place {
        /// First Jacobian row. Equalities come first, so for them it is also the index of the residual.
        pub row: u32,
        /// First inequality. The upper sides of all rows are followed by the lower sides of the first `pairs` rows.
        pub inequality: u32,
        /// Offset in the Jacobian values, which are row-major.
        pub jacobian: u32,
        /// Distance between two rows in the Jacobian values, a multiple of 8; the padding is zero.
        pub stride: u32,
    }
}

impl Span {
    /// Index range of the span.
    #[inline(always)]
    pub fn range(self) -> std::ops::Range<usize> {
        self.start as usize..self.end as usize
    }

    /// Span of the entries added to a table that had `start` entries before.
    pub fn added<E>(start: usize, table: &[E]) -> Span {
        Span { start: start as u32, end: table.len() as u32 }
    }
}
