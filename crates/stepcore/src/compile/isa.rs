//! Instructions: vectors of AVX2 with masks in vectors, or of AVX-512 with masks in registers of their own.

use iced_x86::{Code, Register};

/// The vectors of a processor, and the numbers in them.
#[derive(Clone, Copy, Debug, PartialEq, Eq, Hash)]
pub(crate) struct Isa {
    /// AVX-512.
    pub wide: bool,
    /// `f32`.
    pub single: bool,
}

/// What an instruction does.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub(super) enum Do {
    Add,
    Sub,
    Mul,
    Div,
    Sqrt,
    /// a > b ? a : b, and a < b ? a : b.
    Max,
    Min,
    And,
    Or,
    Xor,
    Compare,
    /// AVX2: of (no, yes) by the fourth; AVX-512: by its mask.
    Choose,
    Load,
    Store,
    Broadcast,
}

/// Predicates of comparisons that hold for no number that is none; and that which holds for those too.
pub(super) const LESS: u8 = 0x11;
pub(super) const AT_MOST: u8 = 0x12;
pub(super) const NOT_AT_MOST: u8 = 0x16;
pub(super) const AT_LEAST: u8 = 0x1D;
pub(super) const ABOVE: u8 = 0x1E;

const VECTORS: usize = 16;

impl Isa {
    /// Bytes of a vector.
    pub fn bytes(self) -> usize {
        if self.wide {
            64
        } else {
            32
        }
    }

    pub fn lanes(self) -> usize {
        self.bytes() / self.size()
    }

    /// Bytes of a number.
    pub fn size(self) -> usize {
        if self.single {
            4
        } else {
            8
        }
    }

    /// Registers for numbers, and for masks if these have their own.
    pub(super) fn registers(self) -> [usize; 2] {
        if self.wide {
            // The first of the others means no mask.
            [2 * VECTORS, 7]
        } else {
            [VECTORS, 0]
        }
    }

    pub(super) fn vector(self, index: u8) -> Register {
        let first = if self.wide { Register::ZMM0 } else { Register::YMM0 };
        first + u32::from(index)
    }

    pub(super) fn mask(index: u8) -> Register {
        Register::K1 + u32::from(index)
    }

    pub(super) fn code(self, what: Do) -> Code {
        match (self.wide, self.single) {
            (false, false) => match what {
                Do::Add => Code::VEX_Vaddpd_ymm_ymm_ymmm256,
                Do::Sub => Code::VEX_Vsubpd_ymm_ymm_ymmm256,
                Do::Mul => Code::VEX_Vmulpd_ymm_ymm_ymmm256,
                Do::Div => Code::VEX_Vdivpd_ymm_ymm_ymmm256,
                Do::Sqrt => Code::VEX_Vsqrtpd_ymm_ymmm256,
                Do::Max => Code::VEX_Vmaxpd_ymm_ymm_ymmm256,
                Do::Min => Code::VEX_Vminpd_ymm_ymm_ymmm256,
                Do::And => Code::VEX_Vandpd_ymm_ymm_ymmm256,
                Do::Or => Code::VEX_Vorpd_ymm_ymm_ymmm256,
                Do::Xor => Code::VEX_Vxorpd_ymm_ymm_ymmm256,
                Do::Compare => Code::VEX_Vcmppd_ymm_ymm_ymmm256_imm8,
                Do::Choose => Code::VEX_Vblendvpd_ymm_ymm_ymmm256_ymm,
                Do::Load => Code::VEX_Vmovups_ymm_ymmm256,
                Do::Store => Code::VEX_Vmovups_ymmm256_ymm,
                Do::Broadcast => Code::VEX_Vbroadcastsd_ymm_m64,
            },
            (false, true) => match what {
                Do::Add => Code::VEX_Vaddps_ymm_ymm_ymmm256,
                Do::Sub => Code::VEX_Vsubps_ymm_ymm_ymmm256,
                Do::Mul => Code::VEX_Vmulps_ymm_ymm_ymmm256,
                Do::Div => Code::VEX_Vdivps_ymm_ymm_ymmm256,
                Do::Sqrt => Code::VEX_Vsqrtps_ymm_ymmm256,
                Do::Max => Code::VEX_Vmaxps_ymm_ymm_ymmm256,
                Do::Min => Code::VEX_Vminps_ymm_ymm_ymmm256,
                Do::And => Code::VEX_Vandps_ymm_ymm_ymmm256,
                Do::Or => Code::VEX_Vorps_ymm_ymm_ymmm256,
                Do::Xor => Code::VEX_Vxorps_ymm_ymm_ymmm256,
                Do::Compare => Code::VEX_Vcmpps_ymm_ymm_ymmm256_imm8,
                Do::Choose => Code::VEX_Vblendvps_ymm_ymm_ymmm256_ymm,
                Do::Load => Code::VEX_Vmovups_ymm_ymmm256,
                Do::Store => Code::VEX_Vmovups_ymmm256_ymm,
                Do::Broadcast => Code::VEX_Vbroadcastss_ymm_m32,
            },
            (true, false) => match what {
                Do::Add => Code::EVEX_Vaddpd_zmm_k1z_zmm_zmmm512b64_er,
                Do::Sub => Code::EVEX_Vsubpd_zmm_k1z_zmm_zmmm512b64_er,
                Do::Mul => Code::EVEX_Vmulpd_zmm_k1z_zmm_zmmm512b64_er,
                Do::Div => Code::EVEX_Vdivpd_zmm_k1z_zmm_zmmm512b64_er,
                Do::Sqrt => Code::EVEX_Vsqrtpd_zmm_k1z_zmmm512b64_er,
                Do::Max => Code::EVEX_Vmaxpd_zmm_k1z_zmm_zmmm512b64_sae,
                Do::Min => Code::EVEX_Vminpd_zmm_k1z_zmm_zmmm512b64_sae,
                Do::And => Code::EVEX_Vandpd_zmm_k1z_zmm_zmmm512b64,
                Do::Or => Code::EVEX_Vorpd_zmm_k1z_zmm_zmmm512b64,
                Do::Xor => Code::EVEX_Vxorpd_zmm_k1z_zmm_zmmm512b64,
                Do::Compare => Code::EVEX_Vcmppd_kr_k1_zmm_zmmm512b64_imm8_sae,
                Do::Choose => Code::EVEX_Vblendmpd_zmm_k1z_zmm_zmmm512b64,
                Do::Load => Code::EVEX_Vmovups_zmm_k1z_zmmm512,
                Do::Store => Code::EVEX_Vmovups_zmmm512_k1z_zmm,
                Do::Broadcast => Code::EVEX_Vbroadcastsd_zmm_k1z_xmmm64,
            },
            (true, true) => match what {
                Do::Add => Code::EVEX_Vaddps_zmm_k1z_zmm_zmmm512b32_er,
                Do::Sub => Code::EVEX_Vsubps_zmm_k1z_zmm_zmmm512b32_er,
                Do::Mul => Code::EVEX_Vmulps_zmm_k1z_zmm_zmmm512b32_er,
                Do::Div => Code::EVEX_Vdivps_zmm_k1z_zmm_zmmm512b32_er,
                Do::Sqrt => Code::EVEX_Vsqrtps_zmm_k1z_zmmm512b32_er,
                Do::Max => Code::EVEX_Vmaxps_zmm_k1z_zmm_zmmm512b32_sae,
                Do::Min => Code::EVEX_Vminps_zmm_k1z_zmm_zmmm512b32_sae,
                Do::And => Code::EVEX_Vandps_zmm_k1z_zmm_zmmm512b32,
                Do::Or => Code::EVEX_Vorps_zmm_k1z_zmm_zmmm512b32,
                Do::Xor => Code::EVEX_Vxorps_zmm_k1z_zmm_zmmm512b32,
                Do::Compare => Code::EVEX_Vcmpps_kr_k1_zmm_zmmm512b32_imm8_sae,
                Do::Choose => Code::EVEX_Vblendmps_zmm_k1z_zmm_zmmm512b32,
                Do::Load => Code::EVEX_Vmovups_zmm_k1z_zmmm512,
                Do::Store => Code::EVEX_Vmovups_zmmm512_k1z_zmm,
                Do::Broadcast => Code::EVEX_Vbroadcastss_zmm_k1z_xmmm32,
            },
        }
    }

    /// The best of this machine, if it has any that this crate writes code for.
    #[cfg(target_arch = "x86_64")]
    pub fn of_this_machine(single: bool) -> Option<Self> {
        let wide = std::arch::is_x86_feature_detected!("avx512f")
            && std::arch::is_x86_feature_detected!("avx512dq");
        let any = wide || std::arch::is_x86_feature_detected!("avx2");
        any.then_some(Self { wide, single })
    }

    #[cfg(not(target_arch = "x86_64"))]
    pub fn of_this_machine(_: bool) -> Option<Self> {
        None
    }
}
