//! Scalar that counts its operations. Kernels are generic over their scalar, so running one with this type counts its operations exactly.

use cregopt::real::Real;
use num_traits::{Float, Num, NumCast, One, ToPrimitive, Zero};
use std::cell::Cell;
use std::num::FpCategory;
use std::ops::{Add, AddAssign, Div, DivAssign, Mul, MulAssign, Neg, Rem, RemAssign, Sub, SubAssign};

/// Numbers of floating-point operations. Comparisons, signs and rounding are not counted.
#[derive(Debug, Clone, Copy, Default, PartialEq, Eq)]
pub struct Operations {
    /// Sums, differences and products; a fused operation counts as two.
    pub simple: u64,
    /// Quotients, roots and functions.
    pub special: u64,
}

impl AddAssign for Operations {
    fn add_assign(&mut self, more: Operations) {
        self.simple += more.simple;
        self.special += more.special;
    }
}

thread_local! {
    static COUNT: Cell<Operations> = const { Cell::new(Operations { simple: 0, special: 0 }) };
}

fn count(simple: u64, special: u64) {
    COUNT.with(|sum| {
        let mut new = sum.get();
        new += Operations { simple, special };
        sum.set(new);
    });
}

/// Number of operations of a call on this thread.
pub fn counted(call: impl FnOnce()) -> Operations {
    COUNT.set(Operations::default());
    call();
    COUNT.get()
}

/// `f32` value whose operations are counted.
#[derive(Debug, Clone, Copy, Default, PartialEq, PartialOrd)]
pub struct Counted(f32);

impl Real for Counted {
    fn of(value: f64) -> Self {
        Counted(value as f32)
    }
    fn as_f64(self) -> f64 {
        self.0.into()
    }
}

macro_rules! operators {
    ($($name:ident $method:ident $assigning:ident $assign:ident $simple:literal $special:literal,)*) => {$(
        impl $name for Counted {
            type Output = Self;
            fn $method(self, other: Self) -> Self {
                count($simple, $special);
                Counted(self.0.$method(other.0))
            }
        }
        impl $assigning for Counted {
            fn $assign(&mut self, other: Self) {
                *self = $name::$method(*self, other);
            }
        }
    )*};
}
operators! {
    Add add AddAssign add_assign 1 0,
    Sub sub SubAssign sub_assign 1 0,
    Mul mul MulAssign mul_assign 1 0,
    Div div DivAssign div_assign 0 1,
    Rem rem RemAssign rem_assign 0 1,
}

impl Neg for Counted {
    type Output = Self;
    fn neg(self) -> Self {
        Counted(-self.0)
    }
}

impl std::iter::Sum for Counted {
    fn sum<I: Iterator<Item = Self>>(values: I) -> Self {
        values.fold(Counted(0.), Add::add)
    }
}

impl Zero for Counted {
    fn zero() -> Self {
        Counted(0.)
    }
    fn is_zero(&self) -> bool {
        self.0 == 0.
    }
}

impl One for Counted {
    fn one() -> Self {
        Counted(1.)
    }
}

impl Num for Counted {
    type FromStrRadixErr = <f32 as Num>::FromStrRadixErr;
    fn from_str_radix(text: &str, radix: u32) -> Result<Self, Self::FromStrRadixErr> {
        f32::from_str_radix(text, radix).map(Counted)
    }
}

impl ToPrimitive for Counted {
    fn to_i64(&self) -> Option<i64> {
        self.0.to_i64()
    }
    fn to_u64(&self) -> Option<u64> {
        self.0.to_u64()
    }
    fn to_f64(&self) -> Option<f64> {
        self.0.to_f64()
    }
}

impl NumCast for Counted {
    fn from<N: ToPrimitive>(value: N) -> Option<Self> {
        value.to_f32().map(Counted)
    }
}

/// Implements the methods of `Float` from their numbers of operations and their names.
macro_rules! float {
    (
        values { $($value:ident)* } asks { $($ask:ident)* }
        unary { $($simple:literal $special:literal: $($unary:ident)*;)* }
        binary { $($s:literal $p:literal: $($binary:ident)*;)* }
    ) => {
        impl Float for Counted {
            $(fn $value() -> Self {
                Counted(<f32 as Float>::$value())
            })*
            $(fn $ask(self) -> bool {
                Float::$ask(self.0)
            })*
            $($(fn $unary(self) -> Self {
                count($simple, $special);
                Counted(Float::$unary(self.0))
            })*)*
            $($(fn $binary(self, other: Self) -> Self {
                count($s, $p);
                Counted(Float::$binary(self.0, other.0))
            })*)*
            fn classify(self) -> FpCategory {
                self.0.classify()
            }
            fn mul_add(self, a: Self, b: Self) -> Self {
                count(2, 0);
                Counted(self.0.mul_add(a.0, b.0))
            }
            fn powi(self, n: i32) -> Self {
                count(n.unsigned_abs().saturating_sub(1).into(), (n < 0).into());
                Counted(self.0.powi(n))
            }
            fn sin_cos(self) -> (Self, Self) {
                (self.sin(), self.cos())
            }
            fn integer_decode(self) -> (u64, i16, i8) {
                Float::integer_decode(self.0)
            }
        }
    };
}
float! {
    values { nan infinity neg_infinity neg_zero min_value min_positive_value max_value }
    asks { is_nan is_infinite is_finite is_normal is_sign_positive is_sign_negative }
    unary {
        0 0: floor ceil round trunc fract abs signum;
        0 1: recip sqrt cbrt exp exp2 ln log2 log10 sin cos tan asin acos atan exp_m1 ln_1p sinh cosh tanh asinh acosh atanh;
    }
    binary {
        0 0: max min;
        1 0: abs_sub;
        0 1: powf log hypot atan2;
    }
}
