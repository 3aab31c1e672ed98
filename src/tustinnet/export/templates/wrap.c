/* A difference of angles, within half a turn to both sides. */
static model_real wrapped(model_real difference)
{
    const model_real turn = R(6.283185307179586);
    return difference - turn * M(floor)(difference / turn + R(0.5));
}

