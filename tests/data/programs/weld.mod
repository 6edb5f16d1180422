MODULE Weld
  CONST robtarget p10:=[[450,0,200],[0,1,0,0],[0,-1,0,1],[9E+09,9E+09,9E+09,9E+09,9E+09,9E+09]];
  PERS tooldata tGun:=[TRUE,[[60,0,120],[1,0,0,0]],[0.8,[20,0,60],[1,0,0,0],0,0,0]];
  ! old: [[450,0,200],[0,1,0,0],[0,-1,0,1],[9E+09,9E+09,9E+09,9E+09,9E+09,9E+09]]
  CONST jointtarget home:=[[5,10,-15.5,2,-70,0.5],[9E+09,9E+09,9E+09,9E+09,9E+09,9E+09]];
  PROC main()
    TPWrite "go [[1,2,3],[1,0,0,0],[0,0,0,0],[0,0,0,0,0,0]]";
    MoveAbsJ home,v100,fine,tGun;
    MoveL p10,v100,fine,tGun\WObj:=wobj0;
    MoveJ [[440,5.25,190],[0,1,0,0],[0,-1,-1,1],[9E+09,9E+09,9E+09,9E+09,9E+09,9E+09]],v100,z10,tGun;
  ENDPROC
ENDMODULE
