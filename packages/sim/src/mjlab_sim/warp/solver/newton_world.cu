// Newton's method for the constrained acceleration of one world, by one block.
//
// It minimises 1/2 (q - qs)' M (q - qs) + sum of the costs of rows of J q - aref, as MuJoCo's Newton solver does.
// This text is the body of a function: `fused_newton.py` defines NV (dofs), NR and NZ (capacity in rows, and in groups
// of four numbers of J), NT (threads), ELLIPTIC, IN_MEMORY (rows are in global memory) and the arguments.
//
// A row of J is stored as the groups of four columns that are not all zero: `groups[r]` has a bit for each group, and the
// place of the first one above bit 16. Thread i owns row i of the Hessian in registers. Rows past the threads are the
// border, a small matrix that every thread has; with one thread (a CPU) it is nearly all.

#if defined(__CUDA_ARCH__)
#define SHARED __shared__
#define UNROLL _Pragma("unroll")
#define COUNT_BITS(x) __popc(x)
#define FIRST_BIT(x) (__ffs(x) - 1)
#define UNROLL_SOME _Pragma("unroll 4")
#define TAKE(counter, amount) atomicAdd(&counter, amount)
#define SUM_OF_WARP(v) for (int o = 16; o > 0; o >>= 1) v += __shfl_xor_sync(0xffffffffu, v, o)
#define SYNC() do { if (NT > 32) __syncthreads(); else __syncwarp(); } while (0)
#elif !defined(SHARED)  // one thread
#define SHARED
#define UNROLL
#define UNROLL_SOME
#define COUNT_BITS(x) __builtin_popcount(x)
#define FIRST_BIT(x) __builtin_ctz(x)
#define TAKE(counter, amount) ((counter += (amount)) - (amount))
#define SUM_OF_WARP(v)
#define SYNC()
#endif

struct alignas(16) Four { float x[4]; };
enum { EQUALITY, FRICTION_LOSS, ONE_SIDED, CONE, TANGENT };              // kinds of rows
enum { SATISFIED, QUADRATIC, LINEAR_NEG, LINEAR_POS, IN_CONE };          // states, numbered as in MuJoCo Warp
const int NQ = (NV + 3) / 4, NP = 4 * NQ, OWN = NV < NT ? NV : NT, NB = NV - OWN, NW = (NT + 31) / 32;
auto larger = [](float a, float b) -> float { return a > b ? a : b; };
const float ROUNDING = 8.0f * 1.1920929e-07f;

alignas(16) SHARED float inertia[NV * NP];
alignas(16) SHARED float q_[NP], Ma_[NP], grad_[NP], search_[NP], Mv_[NP], smooth_[NP], pivot[2][NP + 4];
alignas(16) SHARED float sums[2][NW][4];
SHARED int used;
// Of rows: J q - aref, stiffness, force, curvature, parameter, J search; kind and state; groups.
#if IN_MEMORY
float* const J = given.scratch.data + (long long)block * given.scratch.strides[0] / 4;
float* const x_ = J + 4 * NZ + 4;
float *const D_ = x_ + NR, *const F_ = D_ + NR, *const C_ = F_ + NR, *const P_ = C_ + NR, *const v_ = P_ + NR;
int *const kind_ = (int*)(v_ + NR), *const groups = kind_ + NR;
#else
alignas(16) SHARED float J[4 * NZ + 4];
SHARED float x_[NR], D_[NR], F_[NR], C_[NR], P_[NR], v_[NR];
SHARED int kind_[NR], groups[NR];
#endif

SYNC();  // the block's last world is done with the memory
const int n = given.nefc.data[w] < given.njmax ? given.nefc.data[w] : given.njmax, num_equality = given.ne.data[w], num_loss = given.nf.data[w];
float* const qacc_ = (float*)((char*)given.qacc.data + (long long)w * given.qacc.strides[0]);
float* const force_ = (float*)((char*)given.efc_force.data + (long long)w * given.efc_force.strides[0]);
int* const state_ = (int*)((char*)given.efc_state.data + (long long)w * given.efc_state.strides[0]);
float* const qfrc_ = (float*)((char*)given.qfrc_constraint.data + (long long)w * given.qfrc_constraint.strides[0]);
float* const Ma_out = (float*)((char*)given.efc_Ma.data + (long long)w * given.efc_Ma.strides[0]);
#define ROW_OF(type, array) ((const type*)((const char*)array.data + (long long)w * array.strides[0]))
const float* const initial = n > 0 ? ROW_OF(float, given.start) : ROW_OF(float, given.without_rows);
const float* const smooth_in = ROW_OF(float, given.qfrc_smooth);
if (IN_MEMORY && !given.is_left.data[w]) return;
if (n > NR) {
  if (lane == 0) given.is_left.data[w] = true;
  return;
}

// Rows: their kinds, and which groups of columns they have.
if (lane == 0) used = 0;
for (int i = lane; i < NP; i += NT) {
  q_[i] = i < NV ? initial[i] : 0.0f;
  smooth_[i] = i < NV ? smooth_in[i] : 0.0f;
  search_[i] = 0.0f, Mv_[i] = 0.0f;
}
for (int i = lane; i < NV * NP; i += NT) inertia[i] = 0.0f;
SYNC();
for (int r = lane; r < n; r += NT) {
  unsigned mask = 0;
  if (given.is_sparse) {
    const int* const columns = ROW_OF(int, given.efc_J_colind) + ROW_OF(int, given.efc_J_rowadr)[r];
    const int count = ROW_OF(int, given.efc_J_rownnz)[r];
    for (int k = 0; k < count; k++) mask |= 1u << (columns[k] >> 2);
  } else {
    const Four* const row = (const Four*)((const char*)ROW_OF(float, given.efc_J) + (long long)r * given.efc_J.strides[1]);
    for (int g = 0; g < NQ; g++) {
      const Four a = row[g];
      bool any = false;
      for (int e = 0; e < 4; e++) any = any || (4 * g + e < NV && a.x[e] != 0.0f);
      if (any) mask |= 1u << g;
    }
  }
  groups[r] = (int)(mask | (unsigned)TAKE(used, COUNT_BITS(mask)) << 16);
  int kind = r < num_equality ? EQUALITY : r < num_equality + num_loss ? FRICTION_LOSS : ONE_SIDED;
  float parameter = kind == FRICTION_LOSS ? ROW_OF(float, given.efc_frictionloss)[r] : 0.0f;
  if (ELLIPTIC && ROW_OF(int, given.efc_type)[r] == 7) {
    const int contact = ROW_OF(int, given.efc_id)[r], first = ((const int*)((const char*)given.contact_efc_address.data + (long long)contact * given.contact_efc_address.strides[0]))[0];
    const int k = r - first, dim = given.contact_dim.data[contact];
    const float* const friction = (const float*)&given.contact_friction.data[contact];
    if (first + dim > n) {  // it is cut off by the capacity of the model's buffers
      kind = k == 0 ? ONE_SIDED : FRICTION_LOSS;
    } else if (k == 0) {
      kind = CONE | dim << 4, parameter = friction[0] * given.impratio_invsqrt.data[w % given.impratio_invsqrt.shape[0]];
    } else {
      kind = TANGENT | k << 4, parameter = friction[k - 1];
    }
  }
  kind_[r] = kind, P_[r] = parameter, D_[r] = ROW_OF(float, given.efc_D)[r], v_[r] = 0.0f;
}
for (int i = lane; i < NV; i += NT) {
  const int adr = given.M_rowadr.data[i];
  for (int k = 0; k < given.M_rownnz.data[i]; k++) {
    const int c = given.M_colind.data[adr + k];
    const float value = ROW_OF(float, given.M)[adr + k];
    inertia[i * NP + c] = value, inertia[c * NP + i] = value;
  }
}
SYNC();
if (!IN_MEMORY) {
  const bool fits = used <= NZ;
  if (lane == 0) given.is_left.data[w] = !fits;
  if (!fits) return;
}
for (int r = lane; r < n; r += NT) {
  const unsigned mask = groups[r] & 0xffff;
  float* const to = J + 4 * ((unsigned)groups[r] >> 16);
  if (given.is_sparse) {
    for (int k = 0; k < 4 * COUNT_BITS(mask); k++) to[k] = 0.0f;
    const int adr = ROW_OF(int, given.efc_J_rowadr)[r], count = ROW_OF(int, given.efc_J_rownnz)[r];
    const int* const columns = ROW_OF(int, given.efc_J_colind) + adr;
    const float* const values = ROW_OF(float, given.efc_J) + adr;
    for (int k = 0; k < count; k++) {
      const int c = columns[k];
      to[4 * COUNT_BITS(mask & ((1u << (c >> 2)) - 1)) + (c & 3)] = values[k];
    }
  } else {
    const float* const row = (const float*)((const char*)ROW_OF(float, given.efc_J) + (long long)r * given.efc_J.strides[1]);
    int k = 0;
    for (unsigned left = mask; left; left &= left - 1) {
      const int c = 4 * FIRST_BIT(left);
      for (int e = 0; e < 4; e++) to[k++] = c + e < NV ? row[c + e] : 0.0f;
    }
  }
}
SYNC();

auto times_row = [&](int r, const float* vector) -> float {
  const Four* from = (const Four*)J + ((unsigned)groups[r] >> 16);
  float sum = 0.0f;
  for (unsigned left = groups[r] & 0xffff; left; left &= left - 1) {
    const Four a = *from++, b = ((const Four*)vector)[FIRST_BIT(left)];
    sum += a.x[0] * b.x[0] + a.x[1] * b.x[1] + a.x[2] * b.x[2] + a.x[3] * b.x[3];
  }
  return sum;
};
auto times_inertia = [&](int i, const float* vector) -> float {
  float sum = 0.0f;
  for (int g = 0; g < NQ; g++) {
    const Four b = ((const Four*)vector)[g];
    for (int e = 0; e < 4; e++) if (4 * g + e < NV) sum += inertia[(4 * g + e) * NP + i] * b.x[e];
  }
  return sum;
};
auto entry = [&](int r, int i) -> float {  // J[r, i]
  const unsigned all = groups[r], group = 1u << (i >> 2);
  return all & group ? J[4 * ((all >> 16) + COUNT_BITS(all & (group - 1))) + (i & 3)] : 0.0f;
};
int turn = 0;
auto add_up = [&](Four& a) {  // over threads; every thread gets the same sums
  for (int e = 0; e < 4; e++) SUM_OF_WARP(a.x[e]);
  if (NW > 1) {
    turn ^= 1;
    if ((lane & 31) == 0) *(Four*)sums[turn][lane >> 5] = a;
    SYNC();
    a = *(const Four*)sums[turn][0];
    for (int i = 1; i < NW; i++) for (int e = 0; e < 4; e++) a.x[e] += sums[turn][i][e];
  }
};
auto zone = [](float mu, float N, float T) -> int {
  if (N >= mu * T || (T <= 0.0f && N >= 0.0f)) return SATISFIED;
  return mu * N + T <= 0.0f || T <= 0.0f ? QUADRATIC : IN_CONE;
};
auto cone_stiffness = [](float D, float mu) -> float { return D / (mu * mu * (1.0f + mu * mu)); };

// Move the rows by a step along `v_`, set their forces and curvatures there, and return the change of their cost.
auto move_rows = [&](float step) -> float {
  float change = 0.0f;
  for (int r = lane; r < n; r += NT) {
    const int kind = kind_[r] & 15;
    if (kind == TANGENT) continue;
    const float D = D_[r], x = x_[r], dx = step * v_[r], y = x + dx;
    if (ELLIPTIC && kind == CONE) {
      const int dim = kind_[r] >> 4 & 15;
      const float mu = P_[r], stiffness = cone_stiffness(D, mu), N0 = mu * x, N1 = mu * y;
      float quadratic = 0.0f, moved = 0.0f, TT0 = 0.0f, TT1 = 0.0f, dTT = 0.0f;
      for (int k = 0; k < dim; k++) {
        const float a = x_[r + k], da = step * v_[r + k], b = a + da;
        x_[r + k] = b;
        quadratic += 0.5f * D_[r + k] * a * a, moved += D_[r + k] * da * (a + 0.5f * da);
        if (k) {
          const float u0 = a * P_[r + k], u1 = b * P_[r + k];
          TT0 += u0 * u0, TT1 += u1 * u1, dTT += da * P_[r + k] * (u0 + u1);
        }
      }
      const float T0 = sqrtf(TT0), T1 = sqrtf(TT1), gap0 = N0 - mu * T0, gap1 = N1 - mu * T1;
      const int before = zone(mu, N0, T0), after = zone(mu, N1, T1);
      const float cost = before == QUADRATIC ? quadratic : before == IN_CONE ? 0.5f * stiffness * gap0 * gap0 : 0.0f;
      if (after == before) {
        const float d_gap = T0 + T1 > 0.0f ? mu * (dx - dTT / (T0 + T1)) : mu * dx;
        change += after == QUADRATIC ? moved : after == IN_CONE ? 0.5f * stiffness * d_gap * (2.0f * gap0 + d_gap) : 0.0f;
      } else {
        change -= cost;
        change += after == QUADRATIC ? quadratic + moved : after == IN_CONE ? 0.5f * stiffness * gap1 * gap1 : 0.0f;
      }
      kind_[r] = CONE | dim << 4 | after << 8;
      const float normal = after == IN_CONE ? -stiffness * gap1 * mu : 0.0f;
      for (int k = 0; k < dim; k++) {
        const float b = x_[r + k], scaled = k ? b * P_[r + k] * P_[r + k] : 0.0f;
        if (after == IN_CONE) {
          F_[r + k] = k ? -normal * scaled / T1 : normal;
          C_[r + k] = k ? 0.0f : stiffness;
          v_[r + k] = k ? scaled / T1 : normal / T1;  // direction of the tangent force; curvature across it
        } else {
          F_[r + k] = after == QUADRATIC ? -D_[r + k] * b : 0.0f;
          C_[r + k] = after == QUADRATIC ? D_[r + k] : 0.0f;
        }
      }
      continue;
    }
    x_[r] = y;
    if (kind == FRICTION_LOSS) {
      const float loss = P_[r], bound = loss / D;
      const int before = x <= -bound ? LINEAR_NEG : x >= bound ? LINEAR_POS : QUADRATIC;
      const int after = y <= -bound ? LINEAR_NEG : y >= bound ? LINEAR_POS : QUADRATIC;
      const float cost0 = before == QUADRATIC ? 0.5f * D * x * x : loss * (fabsf(x) - 0.5f * bound);
      const float cost1 = after == QUADRATIC ? 0.5f * D * y * y : loss * (fabsf(y) - 0.5f * bound);
      change += before != after ? cost1 - cost0 : after == QUADRATIC ? D * dx * (x + 0.5f * dx) : after == LINEAR_POS ? loss * dx : -loss * dx;
      F_[r] = after == QUADRATIC ? -D * y : after == LINEAR_POS ? -loss : loss;
      C_[r] = after == QUADRATIC ? D : 0.0f;
      kind_[r] = kind | after << 8;
    } else {
      const bool before = kind == EQUALITY || x < 0.0f, after = kind == EQUALITY || y < 0.0f;
      change += before && after ? D * dx * (x + 0.5f * dx) : after ? 0.5f * D * y * y : before ? -0.5f * D * x * x : 0.0f;
      F_[r] = after ? -D * y : 0.0f;
      C_[r] = after ? D : 0.0f;
      kind_[r] = kind | (after ? QUADRATIC : SATISFIED) << 8;
    }
  }
  return change;
};

// First and second derivative of the rows' cost at a step along `v_`, and the first one's size before cancellation.
auto slope_of_rows = [&](float step, Four& sum) {
  for (int r = lane; r < n; r += NT) {
    const int kind = kind_[r] & 15;
    if (kind == TANGENT) continue;
    const float D = D_[r], v = v_[r], y = x_[r] + step * v;
    float first = 0.0f, second = 0.0f;
    if (ELLIPTIC && kind == CONE) {
      // C_ has the tangent part's position along its own motion, the speed, and the squared distance across.
      const float mu = P_[r], N = mu * y, speed = C_[r + 1], across = C_[r + 2], along = C_[r] + step * speed;
      const float TT = along * along + across, T = sqrtf(TT);
      const int where = zone(mu, N, T);
      if (where == QUADRATIC) {
        const int dim = kind_[r] >> 4 & 15;
        for (int k = 0; k < dim; k++) {
          const float a = D_[r + k] * v_[r + k];
          first += a * (x_[r + k] + step * v_[r + k]), second += a * v_[r + k];
        }
      } else if (where == IN_CONE) {
        const float stiffness = cone_stiffness(D, mu), gap = N - mu * T;
        const float d_gap = mu * (v - along * speed / T), dd_gap = -mu * (across / TT) * (speed * speed / T);
        first = stiffness * gap * d_gap, second = stiffness * (d_gap * d_gap + gap * dd_gap);
      }
    } else if (kind == FRICTION_LOSS && fabsf(y) * D >= P_[r]) {
      first = y > 0.0f ? P_[r] * v : -P_[r] * v;
    } else if (kind != ONE_SIDED || y < 0.0f) {
      first = D * y * v, second = D * v * v;
    }
    sum.x[0] += first, sum.x[1] += second, sum.x[2] += fabsf(first);
  }
};

float trace = 0.0f;
for (int i = lane; i < NV; i += NT) trace += inertia[i * NP + i], Ma_[i] = times_inertia(i, q_);
for (int r = lane; r < n; r += NT) x_[r] = times_row(r, q_) - ROW_OF(float, given.efc_aref)[r];
Four total = {trace, 0.0f, 0.0f, 0.0f};
SYNC();
add_up(total);
const float scale = 1.0f / larger(total.x[0], 1e-15f);
const float tolerance_ = given.tolerance.data[w % given.tolerance.shape[0]];
const float ls_tolerance_ = given.ls_tolerance.data[w % given.ls_tolerance.shape[0]];
const int own = lane < OWN ? lane : OWN - 1;
int iteration = 0;
float step = 0.0f, slope = 0.0f, curvature = 0.0f;
bool is_done = false;

while (true) {
  total.x[1] = move_rows(step);
  SYNC();
  total.x[0] = 0.0f, total.x[2] = 0.0f, total.x[3] = 0.0f;
  for (int i = lane; i < NV; i += NT) {
    q_[i] += step * search_[i], Ma_[i] += step * Mv_[i];
    float sum = Ma_[i] - smooth_[i];
    UNROLL_SOME
    for (int r = 0; r < n; r++) sum -= F_[r] * entry(r, i);
    grad_[i] = sum;
    total.x[0] += sum * sum;
  }
  add_up(total);
  if (iteration > 0 || n == 0) {
    const float improvement = -scale * (step * (slope + 0.5f * step * curvature) + total.x[1]);
    // A world without rows may start at its solution.
    is_done = (iteration > 0 && improvement < tolerance_) || scale * sqrtf(total.x[0]) < tolerance_;
  }
  if (is_done || iteration == given.iterations) break;

  // Row `own` of the Hessian M + J' C J, and the border.
  float h[NV], border[NB ? NB : 1][NB ? NB : 1], b_border[NB ? NB : 1], left_border[NB ? NB : 1];
  UNROLL
  for (int j = 0; j < NV; j++) h[j] = inertia[j * NP + own];
  UNROLL
  for (int t = 0; t < NB; t++) {
    UNROLL
    for (int u = t; u < NB; u++) border[t][u] = inertia[(OWN + t) * NP + OWN + u];
  }
  auto add_row = [&](int r, float left) {
    const Four* from = (const Four*)J + ((unsigned)groups[r] >> 16);
    const int mask = groups[r];
    UNROLL
    for (int g = 0; g < NQ; g++) {
      if (mask >> g & 1) {
        const Four a = *from++;
        UNROLL
        for (int e = 0; e < 4; e++) {
          if (4 * g + e < NV) h[4 * g + e] += left * a.x[e];
          UNROLL
          for (int t = 0; t < NB; t++)
            if (4 * g + e - OWN >= t && 4 * g + e < NV) border[t][4 * g + e - OWN] += left_border[t] * a.x[e];
        }
      }
    }
  };
  for (int r = 0; r < n; r++) {
    const float c = C_[r];
    if (c == 0.0f) continue;
    const bool has_border = NB > 0 && (groups[r] & 0xffff) >> (OWN >> 2) != 0;
    if (!ELLIPTIC || (kind_[r] & 15) != CONE || kind_[r] >> 8 != IN_CONE) {
      if (has_border) {
        UNROLL
        for (int t = 0; t < NB; t++) left_border[t] = c * entry(r, OWN + t);
      }
      add_row(r, c * entry(r, own));
      continue;
    }
    // The cone's curvature is one rank in the gap, and what the tangent force's direction may still turn.
    const int dim = kind_[r] >> 4 & 15;
    const float mu = P_[r], turning = v_[r];
    auto along_force = [&](int i) -> float {
      float sum = 0.0f;
      for (int k = 1; k < dim; k++) sum += v_[r + k] * entry(r + k, i);
      return sum;
    };
    auto left_of = [&](int k, int i, float along) -> float {
      const float gap = c * mu * mu * (entry(r, i) - along), across = P_[r + k] * P_[r + k] * entry(r + k, i);
      return k ? -gap * v_[r + k] + turning * (across - v_[r + k] * along) : gap;
    };
    float along_border[NB ? NB : 1];
    const float along = along_force(own);
    if (NB > 0) {
      UNROLL
      for (int t = 0; t < NB; t++) along_border[t] = along_force(OWN + t);
    }
    for (int k = 0; k < dim; k++) {
      if (NB > 0) {
        UNROLL
        for (int t = 0; t < NB; t++) left_border[t] = left_of(k, OWN + t, along_border[t]);
      }
      add_row(r + k, left_of(k, own, along));
    }
  }

  // Gauss-Jordan elimination of [H | -grad]: a barrier per column, and no substitution back. What is left of H stays
  // symmetric, so that the pivot's row is read off the column that all threads have.
  float b = -grad_[own], inverse = 0.0f;
  UNROLL
  for (int t = 0; t < NB; t++) b_border[t] = -grad_[OWN + t];
  UNROLL
  for (int k = 0; k < OWN; k++) {
    float* const p = pivot[k & 1];
    if (lane < OWN) p[lane] = h[k];
    if (lane == k) {
      p[NP] = b;
      UNROLL
      for (int t = 0; t < NB; t++) p[OWN + t] = h[OWN + t];
    }
    SYNC();
    const float inv = 1.0f / larger(p[k], 1e-15f), pb = p[NP];
    const float f = lane == k ? 0.0f : h[k] * inv;
    if (lane == k) inverse = inv;
    UNROLL
    for (int g = (k + 1) / 4; g < NQ; g++) {
      const Four a = *(const Four*)(p + 4 * g);
      UNROLL
      for (int e = 0; e < 4; e++) {
        const int j = 4 * g + e;
        if (j > k && j < NV) {
          h[j] -= f * a.x[e];
          if (j >= OWN) {
            UNROLL
            for (int t = 0; t < NB; t++) if (t <= j - OWN) border[t][j - OWN] -= p[OWN + t] * inv * a.x[e];
          }
        }
      }
    }
    b -= f * pb;
    UNROLL
    for (int t = 0; t < NB; t++) b_border[t] -= p[OWN + t] * inv * pb;
  }
  UNROLL
  for (int t = 0; t < NB; t++) {
    const float inv = 1.0f / larger(border[t][t], 1e-15f), f = h[OWN + t] * inv;
    UNROLL
    for (int u = t + 1; u < NB; u++) h[OWN + u] -= f * border[t][u];
    b -= f * b_border[t];
    UNROLL
    for (int s = 0; s < NB; s++) {
      if (s == t) continue;
      const float g = (s < t ? border[s][t] : border[t][s]) * inv;
      UNROLL
      for (int u = t + 1; u < NB; u++) if (u >= s) border[s][u] -= g * border[t][u];
      b_border[s] -= g * b_border[t];
    }
    left_border[t] = inv;
  }
  if (lane < OWN) search_[lane] = b * inverse;
  UNROLL
  for (int t = 0; t < NB; t++) if (lane == 0) search_[OWN + t] = b_border[t] * left_border[t];
  SYNC();

  total.x[0] = 0.0f, total.x[1] = 0.0f, total.x[2] = 0.0f, total.x[3] = 0.0f;
  for (int i = lane; i < NV; i += NT) {
    const float s = search_[i], Ms = times_inertia(i, search_);
    Mv_[i] = Ms;
    total.x[0] -= s * grad_[i], total.x[1] += s * (Ma_[i] - smooth_[i]), total.x[2] += s * Ms, total.x[3] += s * s;
  }
  for (int r = lane; r < n; r += NT) v_[r] = times_row(r, search_);
  SYNC();
  add_up(total);
  slope = total.x[1], curvature = total.x[2];
  // The Newton decrement: what a full step would gain.
  is_done = iteration > 0 && 0.5f * scale * total.x[0] < tolerance_;
  if (is_done) break;
  if (ELLIPTIC) {
    for (int r = lane; r < n; r += NT) {
      if ((kind_[r] & 15) != CONE) continue;
      const int dim = kind_[r] >> 4 & 15;
      float uv = 0.0f, vv = 0.0f, across = 0.0f;
      for (int k = 1; k < dim; k++) {
        const float u = x_[r + k] * P_[r + k], v = v_[r + k] * P_[r + k];
        uv += u * v, vv += v * v;
      }
      const float ratio = vv > 0.0f ? uv / vv : 0.0f, speed = sqrtf(vv);
      for (int k = 1; k < dim; k++) {
        const float u = x_[r + k] * P_[r + k] - ratio * v_[r + k] * P_[r + k];
        across += u * u;
      }
      C_[r] = ratio * speed, C_[r + 1] = speed, C_[r + 2] = across;
    }
  }

  // Exact line search: Newton's method for a zero of the slope inside a bracket, from the full step on.
  const float slope_bound = larger(tolerance_ * ls_tolerance_ * sqrtf(total.x[3]) / scale, 1e-6f);
  float low = 0.0f, high = -1.0f, trial = 1.0f;
  step = 0.0f;
  for (int k = 0; k < given.ls_iterations; k++) {
    Four at = {0.0f, 0.0f, 0.0f, 0.0f};
    slope_of_rows(trial, at);
    add_up(at);
    const float first = at.x[0] + slope + trial * curvature, second = at.x[1] + curvature;
    const float noise = ROUNDING * (at.x[2] + fabsf(slope) + trial * curvature);
    if (fabsf(first) < larger(slope_bound, noise)) {
      step = trial;
      break;
    }
    if (first < 0.0f) low = trial; else high = trial;
    step = low;
    float next = trial - first / second;
    if (high >= 0.0f && !(next > low && next < high)) next = 0.5f * (low + high);
    if (next == trial || !(next > low)) break;
    trial = next;
  }
  iteration++;
  is_done = step == 0.0f;
  if (is_done) break;
}

for (int i = lane; i < NV; i += NT) qacc_[i] = q_[i], Ma_out[i] = Ma_[i], qfrc_[i] = Ma_[i] - smooth_[i] - grad_[i];
for (int r = lane; r < n; r += NT) {
  force_[r] = F_[r];
  const int kind = kind_[r] & 15;
  state_[r] = kind_[kind == TANGENT ? r - (kind_[r] >> 4 & 15) : r] >> 8;
}
if (lane == 0) {
  given.solver_niter.data[w] = iteration;
  if (!is_done) given.overflow.data[w] |= LIMIT_REACHED;
}
