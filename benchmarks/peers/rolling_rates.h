/* Right-hand sides of P2 and P3, written once for numbers (NUM double, ROOT sqrt) and
 * once more for vectors of them; see dopri5.c for the equations. */
static const double G = 9.81; /* [m/s^2] */

/* q' and the horizontal velocity of the centre of mass, from v_C in body axes [m/s]. */
INLINE void kinematics(const NUM *restrict y, NUM vx, NUM vy, NUM vz, NUM *restrict d) {
    const NUM q0 = y[0], q1 = y[1], q2 = y[2], q3 = y[3];
    const NUM wx = 0.5 * y[4], wy = 0.5 * y[5], wz = 0.5 * y[6];
    d[0] = -q1 * wx - q2 * wy - q3 * wz;
    d[1] = q0 * wx + q2 * wz - q3 * wy;
    d[2] = q0 * wy + q3 * wx - q1 * wz;
    d[3] = q0 * wz + q1 * wy - q2 * wx;
    d[7] = vx + 2.0 * (-(q2 * q2 + q3 * q3) * vx + (q1 * q2 - q0 * q3) * vy +
                       (q1 * q3 + q0 * q2) * vz);
    d[8] = vy + 2.0 * ((q1 * q2 + q0 * q3) * vx - (q1 * q1 + q3 * q3) * vy +
                       (q2 * q3 - q0 * q1) * vz);
}

/* P2, thin disc on its sharp rim. e = k_h/|k_h| points from the contact to the centre,
 * t = e3 x e; Th is diagonal on (e, t, e3) and c = a e. */
INLINE void rhs_disc(const NUM *restrict y, NUM *restrict d) {
    const double m = 1.0, a = 0.25;
    const double A = 0.25 * m * a * a, B = A + m * a * a, D = 1.5 * m * a * a;
    const NUM q0 = y[0], q1 = y[1], q2 = y[2], q3 = y[3], w3 = y[6];
    const NUM k1 = 2.0 * (q1 * q3 - q0 * q2), k2 = 2.0 * (q2 * q3 + q0 * q1);
    const NUM k3 = 1.0 - 2.0 * (q1 * q1 + q2 * q2);
    const NUM r = 1.0 / ROOT(k1 * k1 + k2 * k2); /* 1 / |k_h| */
    const NUM ex = k1 * r, ey = k2 * r;
    const NUM we = ex * y[4] + ey * y[5], wt = ex * y[5] - ey * y[4];
    const NUM V = a * (w3 - k3 * we * r); /* along t [m/s] */
    const NUM ae = (B - D) / A * wt * w3;
    const NUM at = (m * a * (G * k3 - V * we) + (D - A) * w3 * we) * (1.0 / B);
    d[4] = ex * ae - ey * at;
    d[5] = ey * ae + ex * at;
    d[6] = (A - B) / D * we * wt;
    kinematics(y, -a * w3 * ey, a * w3 * ex, -a * wt, d);
}

/* P3, rattleback: ellipsoid with the centre h above the centre of mass on e3. */
INLINE void rhs_rattleback(const NUM *restrict y, NUM *restrict d) {
    const double m = 1.0, h = 0.01;
    const double aa = 0.2 * 0.2, bb = 0.03 * 0.03, cc = 0.02 * 0.02;
    const double Ixx = 2e-4, Iyy = 1.6e-3, Izz = 1.7e-3, Ixy = -2e-5;
    const NUM q0 = y[0], q1 = y[1], q2 = y[2], q3 = y[3];
    const NUM wx = y[4], wy = y[5], wz = y[6];
    const NUM n1 = 2.0 * (q0 * q2 - q1 * q3), n2 = -2.0 * (q2 * q3 + q0 * q1);
    const NUM n3 = 2.0 * (q1 * q1 + q2 * q2) - 1.0;
    /* rho = A n / s,  V = (A n' - rho (rho . n')) / s,  n' = n x w,  s^2 = n . A n */
    const NUM p1 = n2 * wz - n3 * wy, p2 = n3 * wx - n1 * wz, p3 = n1 * wy - n2 * wx;
    const NUM r = 1.0 / ROOT(aa * n1 * n1 + bb * n2 * n2 + cc * n3 * n3);
    const NUM x = aa * n1 * r, yy = bb * n2 * r, z = cc * n3 * r;
    const NUM rp = x * p1 + yy * p2 + z * p3;
    const NUM V1 = (aa * p1 - x * rp) * r, V2 = (bb * p2 - yy * rp) * r,
                 V3 = (cc * p3 - z * rp) * r;
    const NUM c1 = -x, c2 = -yy, c3 = -h - z;
    /* f = m (-g k - V x w) */
    const NUM f1 = m * (G * n1 - (V2 * wz - V3 * wy));
    const NUM f2 = m * (G * n2 - (V3 * wx - V1 * wz));
    const NUM f3 = m * (G * n3 - (V1 * wy - V2 * wx));
    const NUM a = Ixx + m * (c2 * c2 + c3 * c3), b = Ixy - m * c1 * c2,
                 c = -m * c1 * c3, e = Iyy + m * (c1 * c1 + c3 * c3), f = -m * c2 * c3,
                 g = Izz + m * (c1 * c1 + c2 * c2);
    const NUM L1 = a * wx + b * wy + c * wz, L2 = b * wx + e * wy + f * wz,
                 L3 = c * wx + f * wy + g * wz;
    const NUM M1 = c2 * f3 - c3 * f2 - (wy * L3 - wz * L2);
    const NUM M2 = c3 * f1 - c1 * f3 - (wz * L1 - wx * L3);
    const NUM M3 = c1 * f2 - c2 * f1 - (wx * L2 - wy * L1);
    /* Th^-1 by the adjugate of [[a, b, c], [b, e, f], [c, f, g]] */
    const NUM j11 = e * g - f * f, j12 = c * f - b * g, j13 = b * f - c * e;
    const NUM j22 = a * g - c * c, j23 = b * c - a * f, j33 = a * e - b * b;
    const NUM i = 1.0 / (a * j11 + b * j12 + c * j13);
    d[4] = i * (j11 * M1 + j12 * M2 + j13 * M3);
    d[5] = i * (j12 * M1 + j22 * M2 + j23 * M3);
    d[6] = i * (j13 * M1 + j23 * M2 + j33 * M3);
    kinematics(y, wy * c3 - wz * c2, wz * c1 - wx * c3, wx * c2 - wy * c1, d);
}
